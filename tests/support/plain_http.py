"""httpx without TLS: loading certificates takes longer than most requests."""

from functools import partial
from typing import Final

import httpx

Client: Final = partial(httpx.Client, verify=False, trust_env=False, timeout=60)
delete: Final = partial(httpx.delete, verify=False, trust_env=False, timeout=60)
get: Final = partial(httpx.get, verify=False, trust_env=False, timeout=60)
head: Final = partial(httpx.head, verify=False, trust_env=False, timeout=60)
post: Final = partial(httpx.post, verify=False, trust_env=False, timeout=60)
put: Final = partial(httpx.put, verify=False, trust_env=False, timeout=60)

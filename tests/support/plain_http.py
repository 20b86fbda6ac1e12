"""httpx without encryption: to read certificates takes longer than most requests."""

from __future__ import annotations

from functools import partial
from typing import Final

import httpx

_PLAIN: Final = {"verify": False, "trust_env": False}

Client: Final = partial(httpx.Client, **_PLAIN, timeout=60)
get: Final = partial(httpx.get, **_PLAIN, timeout=60)
head: Final = partial(httpx.head, **_PLAIN, timeout=60)
post: Final = partial(httpx.post, **_PLAIN, timeout=60)
put: Final = partial(httpx.put, **_PLAIN, timeout=60)

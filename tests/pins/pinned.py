"""All pins by name, each with the function that computes it from the present code."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from tests.pins import demo, digests, interface, records, service


def _of_the_service(name: str) -> Any:
    return service.found()[name]


PINS: Final[Mapping[str, Callable[[], Any]]] = {
    "digests": digests.found,
    "demo": demo.found,
    "records": records.found,
    "openapi": interface.openapi,
    "routes": interface.routes,
    "names": interface.names,
    "modules": interface.modules,
    **{
        name: partial(_of_the_service, name)
        for name in ("rows", "exports", "decisions", "responses", "command_line")
    },
}

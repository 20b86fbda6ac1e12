"""The models of request and response bodies, for the service and the client.

A model is imported when it is first used, because pydantic takes a tenth of a second to
import. Nothing else of Unghost is imported here.

The names are those that `__init__.pyi` imports.
"""

from unghost.lazy import imports_of_stub

__getattr__, __dir__ = imports_of_stub(__name__)

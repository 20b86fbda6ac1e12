"""A configuration as a request body: JSON, or the text of a YAML file as it is."""

from __future__ import annotations

from typing import Annotated, Any, Final

from fastapi import Depends, Request

from app.errors import UnsupportedMedia
from app.http.bodies import beside_the_loop
from app.http.routing import body_up_to
from filter_core.config.file import CARLASIMU_ROOT, LoadedConfig, load_config
from unghost.wire.runs import FilterConfigIn

_MEDIA_TYPES: Final = (
    "application/json",
    "application/yaml",
    "application/x-yaml",
    "text/yaml",
)


async def config_body(request: Request) -> LoadedConfig:
    """The configuration in the body; JSON is YAML as well."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip()
    if media_type.lower() not in _MEDIA_TYPES:
        raise UnsupportedMedia(
            "the body must be application/json or application/yaml, "
            f"it says {media_type or 'nothing'!r}"
        )
    return await beside_the_loop(request, await request.body(), load_config)


ConfigBody = Annotated[LoadedConfig, Depends(config_body)]


def described_config() -> dict[str, Any]:
    """The body for the OpenAPI document."""
    schema = {
        "description": "The keys of filter.yaml, or carlasimu's boundingBox.yaml; "
        "every key is optional, nothing at all is the defaults.",
        "anyOf": [
            {"$ref": f"#/components/schemas/{FilterConfigIn.__name__}"},
            {
                "type": "object",
                "required": [CARLASIMU_ROOT],
                "properties": {CARLASIMU_ROOT: {"type": "object"}},
                "additionalProperties": False,
            },
            {"type": "null"},
        ],
    }
    content = {name: {"schema": schema} for name in _MEDIA_TYPES[:2]}
    body = {"requestBody": {"required": True, "content": content}}
    return {**body, **body_up_to("max_config_bytes")}

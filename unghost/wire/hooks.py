"""Hooks: addresses to which events are sent, and the log of what was delivered."""

from __future__ import annotations

from typing import Annotated

from pydantic import AwareDatetime, Field

from unghost.wire.model import RequestModel, ResponseModel, optional
from unghost.wire.words import DeliveredEvent, DeliveryState, HookEvent


class HookIn(RequestModel):
    """A new hook."""

    url: Annotated[
        str,
        Field(
            min_length=1,
            max_length=2000,
            description="Where events are sent by POST: by HTTPS or plain HTTP, at a "
            "host that the setting `UNGHOST_HOOK_HOSTS` lists.",
            examples=["https://ci.example.org/unghost"],
        ),
    ]
    events: Annotated[
        tuple[HookEvent, ...],
        Field(min_length=1, max_length=10, description="Of what it is told."),
    ] = ("run.ended", "export.ended", "dataset.reviewed")
    dataset: str | None = optional(
        description="Only events of this dataset; null: of all."
    )


class Hook(ResponseModel):
    """A hook, without its secret."""

    id: int
    url: str = Field(
        description="Where events are sent.",
        examples=["https://ci.example.org/unghost"],
    )
    events: tuple[HookEvent, ...]
    dataset: str | None = Field(description="Its dataset; null: it is told of all.")
    created_by: str
    created_at: AwareDatetime


class NewHook(Hook):
    """A hook that was just created, with its secret, shown only here."""

    secret: str = Field(
        repr=False,
        description="With it each delivery is signed, as Standard Webhooks says.",
    )


class Delivery(ResponseModel):
    """An event for a hook, and how far its delivery has come."""

    id: int
    webhook_id: str = Field(
        description="The header `webhook-id`: the same in each attempt.",
        examples=["msg_5f0c2f7a9d4e4b1c8a6d3e21"],
    )
    event: DeliveredEvent
    state: DeliveryState
    attempts: int = Field(description="How often it was tried.", examples=[1])
    status: int | None = Field(
        description="Status of the last response; null if there was none.",
        examples=[200],
    )
    error: str | None = Field(
        description="Why the last attempt failed; null if it did not."
    )
    body: str = Field(description="What is sent, byte for byte.")
    due_at: AwareDatetime | None = Field(
        description="When it is tried next; null if it is over."
    )
    created_at: AwareDatetime
    finished_at: AwareDatetime | None

"""What the boxes of a recording or a dataset say about its labels, after a command.

Unknown classes and pixels, and classes of which every box is rejected, are mostly no
ghosts but labels or images that were not understood. The commands name them, with what
can be done, and end with exit code 3.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

import typer

from unghost.cli.screen import Refused, Screen, one_line
from unghost.cli.sources import with_options

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.inspection.remarks import Advice, BoxSummary
    from unghost.client.client import Client

LOOKED_AT: Final = 200
"""Frames whose labels are looked at before a command sends or decides anything."""


@dataclass(frozen=True, kw_only=True)
class UnmappedOptions:
    """Whether to go on if most boxes have an unknown class."""

    allow_unmapped: Annotated[
        bool,
        typer.Option(
            "--allow-unmapped",
            help="Go on although more than half of the boxes have a class that the "
            "filter does not know.",
        ),
    ] = False

    strict_classes: Annotated[
        bool,
        typer.Option(
            "--strict-classes",
            help="Stop before anything is written if any box has a class that the "
            "filter does not know.",
        ),
    ] = False

    def require_known(
        self, boxes: Mapping[str, int], config: FilterConfig, advice: Advice
    ) -> None:
        """Stop if most boxes cannot be measured, before anything is written.

        `boxes` are the numbers of boxes by class. `Refused` if more than half of the
        boxes have an unknown class; with `strict_classes`, if one has.
        """
        from filter_core.inspection.remarks import named_classes

        unmapped = {name: boxes[name] for name in unmapped_names(boxes, config)}
        count, total = sum(unmapped.values()), sum(boxes.values())
        if self.strict_classes and count:
            listed = ", ".join(f"{name} ({boxes[name]:,})" for name in unmapped)
            raise Refused(
                f"--strict-classes: expected classes that the filter knows, found "
                f"{listed}; `classes` of the configuration says which tags they have"
            )
        if self.allow_unmapped or 2 * count <= total:
            return
        unknown, fate = "the filter does not know", "leaves these boxes unmeasured"
        if config.profile == "carlasimu":
            unknown, fate = "profile carlasimu has no colour for", "rejects these boxes"
        remedies = f"{named_classes(unmapped, advice)}; {advice.general}"
        raise Refused(
            one_line(
                f"{count} of {total} boxes have a class that {unknown}, and nothing "
                f"was written: {with_options(remedies)}; "
                f"--allow-unmapped goes on, and {fate}"
            )
        )


def unmapped_names(names: Iterable[str], config: FilterConfig) -> list[str]:
    """The classes for which no tag is accepted, and which the class map does not pass.

    Each class is looked up in the newest family of tags that has it.
    """
    from filter_core.classes import PASS

    plan = config.measuring()
    measured = [name for name in names if plan.measured_class(name) != PASS]
    masks = plan.accept_masks(measured, None).tolist()
    return [name for name, mask in zip(measured, masks, strict=True) if not mask]


@dataclass(frozen=True)
class DatasetAdvice:
    """What can be done about classes of a dataset (`filter_core` has the protocol).

    `default_class` is that of labels that carry none, if there may be such labels;
    `are_frozen`: its classes can be renamed no more.
    """

    dataset: str
    default_class: str | None = None
    classes: tuple[str, ...] = ()
    are_frozen: bool = False

    @property
    def written(self) -> str:
        """What happens to boxes that are unmeasured, as an addition to this word."""
        return " and exported as they came"

    @property
    def general(self) -> str:
        """What helps for every class."""
        return (
            "`classes: {NAME: CLASS}` in its configuration (`unghost config set "
            f"{self.dataset} FILE`) says as what a class is measured, and "
            "{NAME: pass} that it need not be"
        )

    def for_class(self, name: str, meant: str | None) -> str:
        """What helps for this class, whose name perhaps means `meant`; may be empty."""
        if name == self.default_class:
            return "labels without a class; --default-class names theirs"
        if not meant or self.are_frozen:
            return f"did you mean {meant!r}?" if meant else ""
        change = "merge" if meant in self.classes else "rename"
        words = map(shlex.quote, (self.dataset, name, meant))
        return f"`unghost classes {change} {' '.join(words)}`"

    def for_known(self, names: list[str]) -> str:
        """Why these classes have no tags although their names are understood."""
        from filter_core.inspection.remarks import listed_names

        return (
            f"; {listed_names(names)} may be understood when they are measured again ("
            f"`unghost run {self.dataset} --config FILE --measure-again --activate`), "
            "unless the version of CARLA has no tag for them"
        )

    def for_names(self, names: list[str]) -> str:
        """What makes one class of several that are measured alike; empty if nothing."""
        if self.are_frozen:
            return ""
        words = " ".join(map(shlex.quote, (self.dataset, *names[:2])))
        return f"; `unghost classes merge {words}` joins two"


def note_boxes(screen: Screen, summary: BoxSummary) -> bool:
    """Note what should be looked at; returns whether the exit code is to say so."""
    is_of_dataset = isinstance(summary.advice, DatasetAdvice)
    remarks = [*summary.about_names(), *summary.about_pixels()]
    for remark in remarks:
        text = remark.text if is_of_dataset else with_options(remark.text)
        screen.note(one_line(text))
    return any(remark.is_serious for remark in remarks)


def summary_of(
    client: Client, dataset: str, default_class: str | None = None
) -> BoxSummary:
    """The boxes of a dataset, by the server's counts."""
    from filter_core.inspection.remarks import BoxSummary
    from filter_core.local import ClassCount

    described, stats = client.dataset(dataset), client.stats(dataset)
    advice = DatasetAdvice(
        default_class=default_class,
        dataset=dataset,
        classes=described.classes,
        are_frozen=described.classes_frozen,
    )
    unknown = client.histogram(dataset).unknown_percent if stats.boxes else {}
    summary = BoxSummary(advice, unknown)
    for name, counts in stats.by_class.items():
        boxes = counts.kept + counts.rejected + counts.unmeasured
        reasons = stats.reasons_by_class.get(name, {})
        unmapped = reasons.get("unmapped_class", 0)
        summary.add({name: ClassCount(boxes, counts.rejected, unmapped)})
    return summary

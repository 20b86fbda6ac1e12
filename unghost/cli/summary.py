"""What the boxes of a recording or a dataset say about its labels, after a command.

Unknown classes and pixels, and classes of which every box is rejected, are mostly no
ghosts but labels or images that were not understood. The commands name them, with what
can be done, and end with exit code 3.
"""

from __future__ import annotations

import shlex
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple

import typer

from unghost.cli.screen import Refused, Screen, one_line

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.local import ClassCount
    from unghost.client.client import Client

_ENOUGH_BOXES: Final = 20
"""From so many boxes on, it is no chance if all of them are rejected."""
_MOST_UNKNOWN_PERCENT: Final = 1.0
"""Of the pixels in the boxes of a class."""
_LISTED: Final = 20
"""Classes that are named."""
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

    def require_known(
        self,
        boxes: Mapping[str, int],
        config: FilterConfig,
        advice: Advice,
    ) -> None:
        """Stop if most boxes cannot be measured, before anything is written.

        Parameters
        ----------
        boxes : mapping of str to int
            The number of boxes of each class.
        config : FilterConfig
        advice : Advice

        Raises
        ------
        Refused
            More than half of the boxes have an unknown class.
        """
        unmapped = {name: boxes[name] for name in unmapped_names(boxes, config)}
        count, total = sum(unmapped.values()), sum(boxes.values())
        if self.allow_unmapped or 2 * count <= total:
            return
        unknown, fate = "the filter does not know", "leaves these boxes unmeasured"
        if config.profile == "carlasimu":
            unknown, fate = "profile carlasimu has no colour for", "rejects these boxes"
        raise Refused(
            one_line(
                f"{count} of {total} boxes have a class that {unknown}, and nothing "
                f"was written: {_named(unmapped, advice)}; {advice.general}; "
                f"--allow-unmapped goes on, and {fate}"
            )
        )


def unmapped_names(names: Iterable[str], config: FilterConfig) -> list[str]:
    """The classes for which no tag is accepted, and which the class map does not pass.

    Each class is looked up in the newest family of tags that has it.
    """
    from filter_core.classes import PASS

    plan = config.measuring()
    wanted = [name for name in names if plan.measured_class(name) != PASS]
    masks = plan.accept_masks(wanted, None).tolist()
    return [name for name, mask in zip(wanted, masks, strict=True) if not mask]


@dataclass(frozen=True)
class Advice:
    """What can be done about classes, where boxes have been read from labels.

    Attributes
    ----------
    default_class : str or None
        The class of labels that carry none, if there may be such labels.
    written : str
        What happens to boxes that are unmeasured, as an addition to this word.
    """

    default_class: str | None = None
    written: str = ""

    @property
    def general(self) -> str:
        """What helps for every class."""
        return (
            "--class-map NAME=CLASS says as what a class is measured, and NAME=pass "
            "that it need not be"
        )

    def for_class(self, name: str, meant: str | None) -> str:
        """What helps for this class, whose name perhaps means `meant`; may be empty."""
        if name == self.default_class:
            return "labels without a class; --default-class names theirs"
        return f"--class-map {name}={meant}" if meant else ""

    def for_known(self, names: list[str]) -> str:
        """Why classes have no tags although their names are understood."""
        if not names:
            return ""
        return f"; the tags of this version of CARLA have none for {_listed(names)}"

    def for_names(self, names: list[str]) -> str:
        """What makes one class of several that are measured alike; empty if nothing."""
        other, name = names[:2]
        return f"; `classes: {{{other}: {{name: {name}}}}}` in recording.yaml joins two"


@dataclass(frozen=True)
class DatasetAdvice(Advice):
    """What can be done about classes of a dataset.

    Attributes
    ----------
    dataset : str
    classes : tuple of str
        Those of the dataset.
    are_frozen : bool
        Whether they can be renamed no more.
    """

    written: str = " and exported as they came"
    dataset: str = ""
    classes: tuple[str, ...] = ()
    are_frozen: bool = False

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
            return super().for_class(name, meant)
        if not meant or self.are_frozen:
            return f"did you mean {meant!r}?" if meant else ""
        change = "merge" if meant in self.classes else "rename"
        words = map(shlex.quote, (self.dataset, name, meant))
        return f"`unghost classes {change} {' '.join(words)}`"

    def for_known(self, names: list[str]) -> str:
        """Why classes have no tags although their names are understood."""
        if not names:
            return ""
        return (
            f"; {_listed(names)} may be understood when they are measured again ("
            f"`unghost run {self.dataset} --config FILE --measure-again --activate`), "
            "unless the version of CARLA has no tag for them"
        )

    def for_names(self, names: list[str]) -> str:
        """What makes one class of several that are measured alike; empty if nothing."""
        if self.are_frozen:
            return ""
        words = " ".join(map(shlex.quote, (self.dataset, *names[:2])))
        return f"; `unghost classes merge {words}` joins two"


class Remark(NamedTuple):
    """A sentence about a recording, and whether the exit code is to say so."""

    text: str
    is_serious: bool


@dataclass
class BoxSummary:
    """Counts boxes by class, and says at the end what should be looked at.

    `unknown_percent` is the share of unknown pixels by class, where it is not counted.
    """

    advice: Advice = field(default_factory=Advice)
    unknown_percent: Mapping[str, float] = field(default_factory=dict)
    _classes: dict[str, ClassCount] = field(default_factory=dict)

    def add(self, classes: Mapping[str, ClassCount]) -> None:
        """Count boxes, such as those of a frame."""
        for name, count in classes.items():
            known = self._classes.get(name)
            self._classes[name] = count if known is None else known.plus(count)

    @property
    def boxes(self) -> dict[str, int]:
        """How many boxes each class has."""
        return {name: count.boxes for name, count in self._classes.items()}

    def note(self, screen: Screen) -> bool:
        """Note what should be looked at; returns whether the exit code is to say so."""
        remarks = [*self.about_names(), *self.about_pixels()]
        for remark in remarks:
            screen.note(one_line(remark.text))
        return any(remark.is_serious for remark in remarks)

    def about_names(self) -> list[Remark]:
        """What is to be said about the names of classes."""
        return [*self._unmapped(), *self._names_of_one_class()]

    def about_pixels(self) -> list[Remark]:
        """What is to be said about what was measured."""
        return [*self._rejected(), *self._unknown_pixels()]

    def _count(self, of: Callable[[ClassCount], int]) -> dict[str, int]:
        """The classes for which a count is not 0, by name."""
        counts = {name: of(self._classes[name]) for name in sorted(self._classes)}
        return {name: count for name, count in counts.items() if count}

    def _unmapped(self) -> list[Remark]:
        from filter_core.class_names import class_meant_by

        unmapped = self._count(lambda count: count.unmapped)
        if not unmapped:
            return []
        of_unmapped = [self._classes[name] for name in unmapped]
        is_dropped = all(count.rejected == count.boxes for count in of_unmapped)
        count = sum(unmapped.values())
        whose = "its" if count == 1 else "their"
        why = f"since the filter does not know {whose} class"
        what = f"unmeasured{self.advice.written}, {why}"
        if is_dropped:
            what = "rejected, since profile carlasimu drops classes without a colour"
        boxes = f"{count} boxes are"
        if count == 1:
            boxes, what = "1 box is", what.replace("they came", "it came")
        named = _named(unmapped, self.advice)
        meant = self.advice.for_known(
            [name for name in unmapped if class_meant_by(name)]
        )
        text = f"{boxes} {what}: {named}; {self.advice.general}{meant}"
        return [Remark(text, is_serious=True)]

    def _rejected(self) -> list[Remark]:
        known = {
            name: count.boxes
            for name, count in sorted(self._classes.items())
            if count.rejected == count.boxes and not count.unmapped
        }
        measured = [count for count in self._classes.values() if not count.unmapped]
        total = sum(count.boxes for count in measured)
        rejected = sum(count.rejected for count in measured)
        if total and rejected == total:
            which = "" if len(measured) == len(self._classes) else " of a known class"
            text = f"every box{which} is rejected ({total})"
            return [Remark(f"{text}; {_LOOK}", is_serious=total >= _ENOUGH_BOXES)]
        if not known:
            return []
        is_serious = max(known.values()) >= _ENOUGH_BOXES
        hint = f"; {_LOOK}" if is_serious else ""
        named = _listed(f"{name} ({count})" for name, count in known.items())
        return [Remark(f"every box is rejected of: {named}{hint}", is_serious)]

    def _unknown_pixels(self) -> list[Remark]:
        counted = {
            name: 100 * count.unknown_pixels / count.pixels
            for name, count in self._classes.items()
            if count.pixels
        }
        shares = {**counted, **self.unknown_percent}
        many = {
            name: share
            for name, share in sorted(shares.items())
            if share > _MOST_UNKNOWN_PERCENT
        }
        if not many:
            return []
        named = _listed(f"{name} ({share:.1f} %)" for name, share in many.items())
        return [
            Remark(
                "tags or colours of the segmentation that are unknown inside boxes of: "
                f"{named}; boxes that these pixels could keep are unmeasured; if "
                "another version of CARLA made the images, their palette or "
                "carla_version is wrong",
                is_serious=True,
            )
        ]

    def _names_of_one_class(self) -> list[Remark]:
        from filter_core.class_names import class_meant_by

        names: dict[str, list[str]] = defaultdict(list)
        for name in sorted(self._classes):
            if meaning := class_meant_by(name):
                names[meaning].append(name)
        alike = {name: same for name, same in names.items() if len(same) > 1}
        if not alike:
            return []
        groups = [
            f"{_listed(f'{name} ({self.boxes[name]})' for name in same)} ({meaning}"
            f"{self.advice.for_names(same)})"
            for meaning, same in alike.items()
        ]
        return [
            Remark(
                "names of one class, which are measured alike and kept apart: "
                f"{'; '.join(groups)}",
                is_serious=False,
            )
        ]


_LOOK: Final = (
    "look at some of them: labels in other units or of other images, or a wrong "
    "palette reject every box (--unit, --corners, --palette)"
)


def _named(boxes: Mapping[str, int], advice: Advice) -> str:
    """Unmapped classes with their numbers of boxes, and what helps for each."""
    from filter_core.class_names import class_meant_by, misspelt_class

    named = []
    for name, count in boxes.items():
        meant = None if class_meant_by(name) else misspelt_class(name)
        hint = advice.for_class(name, meant)
        named.append(f"{name} ({count}; {hint})" if hint else f"{name} ({count})")
    return _listed(named)


def _listed(parts: Iterable[str]) -> str:
    listed = list(parts)
    more = len(listed) - _LISTED
    return ", ".join(listed[:_LISTED] + ([f"and {more} more"] if more > 0 else []))


def summary_of(
    client: Client, dataset: str, default_class: str | None = None
) -> BoxSummary:
    """The boxes of a dataset, by the server's counts."""
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

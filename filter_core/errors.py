"""The base of all errors, and those of the library for bad input, as one tree.

UnghostError              also the base of the service's errors, see `app.errors`
FilterError
|-- ImageError            a file is not an image that can be used
|   |-- ImageSizeMismatch segmentation, image and camera disagree about the size
|   `-- ImageTooLarge     a header promises more pixels than the limit allows
|-- SegmentationError     an image, but not a segmentation that can be trusted
|-- AnnotationError       one fault in a frame's annotation
|-- AnnotationErrors      all faults of one annotation
|-- JsonError             text that is not JSON, or more of it than is read
|-- ConfigError           a filter configuration that cannot be used
|-- NotAvailable          asked for something this version does not offer
`-- LayoutError           a folder or label file that cannot be read

Messages name the object, the expected and the found value; never a path of the server.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import ClassVar, TypedDict


class UnghostError(Exception):
    """Base of the errors that people and programs are told.

    `code`, and `kind`, which a single error may change, are stable and for programs;
    `detail` is the text for people.
    """

    code: ClassVar[str] = "internal"

    def __init__(self, detail: str, *, code: str = "") -> None:
        super().__init__(detail)
        self.detail = detail
        self.kind = code or type(self).code


class FilterError(UnghostError, ValueError):
    """Base of everything the library raises on bad input.

    `pointer` is the JSON pointer of the field where there is one.
    """

    code = "bad_input"

    def __init__(self, detail: str, *, pointer: str = "", code: str = "") -> None:
        super().__init__(detail, code=code)
        self.pointer = pointer

    def __reduce__(self) -> tuple[object, ...]:
        """Pickles all attributes, so that errors can be sent between processes."""
        return restored, (type(self), self.args, vars(self))


def restored(
    kind: type[FilterError], args: tuple[object, ...], attributes: dict[str, object]
) -> FilterError:
    """An error as another process raised it."""
    error = kind.__new__(kind, *args)
    vars(error).update(attributes)
    return error


class ImageError(FilterError):
    """A file is not an image that can be used."""

    code = "bad_image"


class ImageSizeMismatch(ImageError):
    """Segmentation, image and camera disagree about the size."""

    code = "image_size_mismatch"


class ImageTooLarge(ImageError):
    """A header promises more pixels than the limit allows."""

    code = "image_too_large"


class SegmentationError(FilterError):
    """The image cannot be trusted as a segmentation; `kind` says how."""

    code = "bad_segmentation"


class AnnotationError(FilterError):
    """One fault in a frame's annotation."""

    code = "bad_annotation"


class AnnotationErrors(FilterError):
    """The faults of one annotation, found in one pass.

    `errors` are the first of them, one at least; `count` is how many there are in all,
    which is more where a reader stopped keeping them.
    """

    code = "bad_annotation"

    def __init__(
        self, errors: Sequence[AnnotationError], count: int | None = None
    ) -> None:
        self.errors = tuple(errors)
        self.count = len(self.errors) if count is None else count
        first = errors[0].detail
        more = f" (and {self.count - 1} more)" if self.count > 1 else ""
        super().__init__(f"{first}{more}", pointer=errors[0].pointer)

    @property
    def more_errors(self) -> int:
        """How many faults there are besides those in `errors`."""
        return self.count - len(self.errors)


class JsonError(FilterError):
    """Text that is not JSON, or more of it than is read.

    `found` is what was found instead.
    """

    code = "not_json"

    def __init__(self, found: str, *, code: str = "") -> None:
        super().__init__(f"expected JSON in UTF-8, found {found}", code=code)
        self.found = found


class ConfigError(FilterError):
    """A filter configuration that cannot be used."""

    code = "bad_config"


class NotAvailable(FilterError):
    """Asked for something that this version does not offer."""

    code = "not_available"


class LayoutError(FilterError):
    """A folder or a label file that cannot be read."""

    code = "bad_layout"


@contextmanager
def error_context(key: str = "", pointer: str = "") -> Iterator[None]:
    """Add the frame's key and the part's pointer to an error raised in the block.

    A pointer that the error has already stays.
    """
    try:
        yield
    except AnnotationErrors:
        raise  # each of them contains the frame and a pointer
    except FilterError as error:
        text = error.detail
        if key and not text.startswith(f"frame {key}"):
            text = f"frame {key}: {text}"
        raise type(error)(
            text, pointer=error.pointer or pointer, code=error.kind
        ) from error


@contextmanager
def file_context(kind: str) -> Iterator[None]:
    """Name the file of a frame that an error about an image is about.

    `kind` is the file's, such as ``segmentation``. It begins the message, and is the
    pointer if the error has none.
    """
    try:
        yield
    except ImageError as error:
        raise type(error)(
            f"{kind}: {error.detail}",
            pointer=error.pointer or f"/{kind}",
            code=error.kind,
        ) from error


class Fault(TypedDict):
    """One error in the list of a problem object.

    `pointer` is the JSON pointer of the field; `code` is for programs, `detail` for
    people.
    """

    pointer: str
    code: str
    detail: str


class _OneProblem(TypedDict):
    title: str
    detail: str
    code: str
    errors: list[Fault]


class ProblemObject(_OneProblem, total=False):
    """What `problem_of` gives; ``more_errors`` only where some are not listed."""

    more_errors: int


def problem_of(error: FilterError) -> ProblemObject:
    """An error as the problem object that the API answers, without its HTTP part."""
    several = error if isinstance(error, AnnotationErrors) else None
    more = several.more_errors if several else 0
    problem: ProblemObject = {
        "title": type(error).__name__,
        "detail": error.detail,
        "code": error.kind,
        "errors": [
            {"pointer": part.pointer, "code": part.kind, "detail": part.detail}
            for part in (several.errors if several else (error,))
        ],
    }
    if more:
        problem["more_errors"] = more
    return problem

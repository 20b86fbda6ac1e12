"""Boxes of a dataset: one object after the other, or all of them as a table.

The server sends tables as columns. They become a data frame without an object for each
box, and are read in a tenth of the time.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Concatenate,
    Final,
    Generic,
    Literal,
    ParamSpec,
    Protocol,
    TypeAlias,
    TypeVar,
    get_args,
    get_origin,
    overload,
)

from unghost import wire
from unghost.client.call import (
    API,
    AsyncSender,
    Call,
    Listing,
    Sender,
    answer,
    passed_to,
)

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow

    from unghost.wire.model import Json

T = TypeVar("T")
S = TypeVar("S")
P = ParamSpec("P")

Columns: TypeAlias = dict[str, list[object]]
"""Lists of equal length by the names of their columns; None where nothing is known."""

Progress: TypeAlias = Callable[[int], object]
"""Called with the number of boxes that have arrived."""

_PAGE_ROWS: Final = 20_000

_LIST_ONLY: Final = ("sort", "limit", "count", "cursor")


class Boxes(Iterator["wire.Decision"]):
    """The boxes of a list: an iterator over them, or a table of all of them.

    A table has the boxes in the order of frames. `fields` names its columns
    (docs/client.md lists them); without it, all are read but those that take long.
    """

    def __init__(self, client: Sender, listing: Listing[wire.Decision]) -> None:
        self._client, self._listing = client, listing
        self._items: Iterator[wire.Decision] | None = None

    def __iter__(self) -> Iterator[wire.Decision]:
        return self

    def __next__(self) -> wire.Decision:
        if self._items is None:
            self._items = self._client._pages(self._listing)
        return next(self._items)

    def columns(
        self,
        fields: Sequence[str] = (),
        *,
        most: int = 0,
        progress: Progress | None = None,
    ) -> Columns:
        """The table as lists, of so many boxes at most; 0: of all.

        Raises
        ------
        BadRequest
            There is no such column.
        ValueError
            The list has an order of its own, which a table has not.
        """
        table, cursor = _Table(self._listing, fields, most), None
        while cursor is not None or not table.pages:
            cursor = table.add(self._client._send(table.page(cursor)), progress)
        return table.columns()

    def to_pandas(
        self, fields: Sequence[str] = (), *, progress: Progress | None = None
    ) -> pandas.DataFrame:
        """The table as a data frame of pandas, which has to be installed."""
        return to_pandas(self.columns(fields, progress=progress))

    def to_polars(
        self, fields: Sequence[str] = (), *, progress: Progress | None = None
    ) -> polars.DataFrame:
        """The table as a data frame of Polars, which has to be installed."""
        return to_polars(self.columns(fields, progress=progress))

    def to_arrow(
        self, fields: Sequence[str] = (), *, progress: Progress | None = None
    ) -> pyarrow.Table:
        """The table for Arrow, which ``unghost[parquet]`` installs."""
        return to_arrow(self.columns(fields, progress=progress))


class AsyncBoxes:
    """As `Boxes`, for an `AsyncClient`."""

    def __init__(self, client: AsyncSender, listing: Listing[wire.Decision]) -> None:
        self._client, self._listing = client, listing

    def __aiter__(self) -> AsyncIterator[wire.Decision]:
        return self._client._pages(self._listing)

    async def columns(
        self,
        fields: Sequence[str] = (),
        *,
        most: int = 0,
        progress: Progress | None = None,
    ) -> Columns:
        """The table as lists; see `Boxes.columns`."""
        table, cursor = _Table(self._listing, fields, most), None
        while cursor is not None or not table.pages:
            page = await self._client._send(table.page(cursor))
            cursor = table.add(page, progress)
        return table.columns()

    async def to_pandas(
        self, fields: Sequence[str] = (), *, progress: Progress | None = None
    ) -> pandas.DataFrame:
        """The table as a data frame of pandas, which has to be installed."""
        return to_pandas(await self.columns(fields, progress=progress))

    async def to_polars(
        self, fields: Sequence[str] = (), *, progress: Progress | None = None
    ) -> polars.DataFrame:
        """The table as a data frame of Polars, which has to be installed."""
        return to_polars(await self.columns(fields, progress=progress))

    async def to_arrow(
        self, fields: Sequence[str] = (), *, progress: Progress | None = None
    ) -> pyarrow.Table:
        """The table for Arrow, which ``unghost[parquet]`` installs."""
        return to_arrow(await self.columns(fields, progress=progress))


class _Table:
    """Collects the pages of a table."""

    def __init__(
        self, listing: Listing[wire.Decision], fields: Sequence[str], most: int
    ) -> None:
        query = listing.params
        if query.get("sort", "id") != "id":
            raise ValueError(
                f"expected no sort for a table, found {query['sort']!r}: its boxes are "
                "in the order of frames; sort the data frame"
            )
        kept = {name: value for name, value in query.items() if name not in _LIST_ONLY}
        self._params = kept
        if fields:
            self._params["fields"] = ",".join(fields)
        self.pages: list[Mapping[str, list[object]]] = []
        self._rows, self._most = 0, most

    def page(self, cursor: str | None) -> Call[Json]:
        """The call for the first page, or for the page that the cursor names."""
        limit = min(_PAGE_ROWS, self._most - self._rows if self._most else _PAGE_ROWS)
        params = {**self._params, "limit": limit, "cursor": cursor}

        def read(body: Json) -> Json:
            body["columns"], body["rows"], body["next_cursor"]  # LookupError without
            return body

        return Call("GET", f"{API}/boxes/table", answer(read), params=params)

    def add(self, page: Json, progress: Progress | None) -> str | None:
        """Keep a page; the cursor of the next one, if another one is needed."""
        self.pages.append(page["columns"])
        self._rows += page["rows"]
        if progress is not None:
            progress(self._rows)
        cursor: str | None = page["next_cursor"]
        return None if self._most and self._rows >= self._most else cursor

    def columns(self) -> Columns:
        """All pages together."""
        columns: Columns = {name: [] for name in self.pages[0]}
        for page in self.pages:
            for name, values in page.items():
                columns[name] += values
        if self._most:  # a page has whole frames
            columns = {name: values[: self._most] for name, values in columns.items()}
        return columns


def kinds() -> dict[str, tuple[type, bool]]:
    """What each column holds (str, float, int or bool), and whether it may be None."""
    by_column: dict[str, tuple[type, bool]] = {}
    for name, field in wire.BoxColumns.model_fields.items():
        (inner,) = get_args(field.annotation)
        types = set(_types_in(inner))
        (plain,) = types - {type(None)}
        by_column[field.alias or name] = (plain, type(None) in types)
    return by_column


def _types_in(annotation: object) -> Iterator[type]:
    if isinstance(annotation, type):
        yield annotation
    elif get_origin(annotation) is Literal:
        yield from map(type, get_args(annotation))
    else:
        for argument in get_args(annotation):
            yield from _types_in(argument)


def to_pandas(columns: Columns) -> pandas.DataFrame:
    """A data frame: whole numbers that may be missing are ``Int64``, texts ``str``."""
    import pandas

    types: dict[type, str] = {float: "float64", bool: "bool"}
    of = kinds()
    return pandas.DataFrame(
        {
            name: pandas.array(values, dtype="Int64" if of[name][1] else "int64")
            if of[name][0] is int
            else pandas.Series(values, dtype=types.get(of[name][0], "object"))
            for name, values in columns.items()
        }
    )


def to_polars(columns: Columns) -> polars.DataFrame:
    """A data frame with the types of the columns, also where all values are missing."""
    import polars

    types = {str: polars.String, float: polars.Float64, int: polars.Int64}
    of = kinds()
    return polars.DataFrame(
        columns,
        schema={name: types.get(of[name][0], polars.Boolean) for name in columns},
    )


def to_arrow(columns: Columns) -> pyarrow.Table:
    """A table with the types of the columns, also where all values are missing."""
    import pyarrow

    types: dict[type, str] = {
        str: "string",
        float: "float64",
        int: "int64",
        bool: "bool_",
    }
    of = kinds()
    schema = pyarrow.schema(
        [(name, getattr(pyarrow, types[of[name][0]])()) for name in columns]
    )
    return pyarrow.Table.from_pydict(columns, schema=schema)


class BoxSender(Sender, Protocol):
    """A client that also lists boxes."""

    def _boxes(self, listing: Listing[wire.Decision], /) -> Boxes: ...


class AsyncBoxSender(AsyncSender, Protocol):
    """A client that also lists boxes, and whose results are awaited."""

    def _boxes(self, listing: Listing[wire.Decision], /) -> AsyncBoxes: ...


if TYPE_CHECKING:
    # As `endpoint` in `call`.

    class BoxesEndpoint(Generic[P]):
        """A method that lists boxes."""

        def __init__(
            self, describe: Callable[Concatenate[S, P], Listing[wire.Decision]]
        ) -> None: ...
        @overload
        def __get__(self, client: BoxSender, kind: object) -> Callable[P, Boxes]: ...
        @overload
        def __get__(
            self, client: AsyncBoxSender, kind: object
        ) -> Callable[P, AsyncBoxes]: ...
        def __get__(self, client: object, kind: object) -> object: ...

    box_listing = BoxesEndpoint

else:
    box_listing = passed_to("_boxes", ".+", "Boxes")

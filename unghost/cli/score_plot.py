"""Scores with their intervals as a picture: a dot and a whisker for each channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final
from xml.sax.saxutils import escape

_WIDTH, _ROW, _TITLES = 640, 34, 220
_TOP, _BOTTOM = 28, 46
_TICKS: Final = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)

Score = Mapping[str, Any]


def f1_plot(rows: Sequence[tuple[str, Score]]) -> str:
    """F1 of each channel with its 95 % interval, as an SVG document."""
    known = [(title, score["f1"]) for title, score in rows if score["f1"] is not None]
    lowest = min((score["low"] for _, score in known), default=0.0)
    ticks = [tick for tick in _TICKS if tick >= lowest - 0.1]
    height = _ROW * len(known) + _BOTTOM
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" '
        'font-family="system-ui, sans-serif" font-size="13" role="img" '
        'aria-label="F1 of each channel with its 95 % interval">',
        f'<rect width="{_WIDTH}" height="{height}" fill="#ffffff"/>',
        *(_tick(tick, ticks[0], height) for tick in ticks),
        *(
            _row(title, score, ticks[0], _TOP + _ROW * number)
            for number, (title, score) in enumerate(known)
        ),
    ]
    return "\n".join([*parts, "</svg>\n"])


def _x(value: float, lowest: float) -> float:
    share = (value - lowest) / (1 - lowest)
    return _TITLES + share * (_WIDTH - _TITLES - 30)


def _tick(tick: float, lowest: float, height: int) -> str:
    x = f"{_x(tick, lowest):.1f}"
    return (
        f'<line x1="{x}" x2="{x}" y1="10" y2="{height - 30}" stroke="#d9dee3"/>'
        f'<text x="{x}" y="{height - 12}" text-anchor="middle" fill="#4a5560">'
        f"{tick:.1f}</text>"
    )


def _row(title: str, score: Mapping[str, float], lowest: float, y: int) -> str:
    low, high = (_x(score[end], lowest) for end in ("low", "high"))
    return (
        f'<text x="{_TITLES - 12}" y="{y + 4}" text-anchor="end" fill="#1d2429">'
        f"{escape(title)}</text>"
        f'<line x1="{low:.1f}" x2="{high:.1f}" y1="{y}" y2="{y}" stroke="#00735c" '
        'stroke-width="3"/>'
        f'<circle cx="{_x(score["value"], lowest):.1f}" cy="{y}" r="5.5" '
        'fill="#00735c"/>'
    )

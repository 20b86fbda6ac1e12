"""A contact sheet of frames before and after the filter, and a page of them.

The page opens from the disk: it has a slider for each frame, and names the pictures in
``before/`` and ``after/`` beside it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from html import escape
from typing import Final
from urllib.parse import quote

import cv2
import numpy as np

from filter_core.images.drawing import Picture, write

MOST_TILES: Final = 60
"""Frames on a contact sheet: the first ones that are drawn."""
CAPTION_PX: Final = 28
_COLUMNS: Final = 4
_TILE_WIDTH_PX: Final = 480
_GAP_PX: Final = 12
_CORNER: Final = (6, CAPTION_PX)
_WHITE: Final = (255, 255, 255)
_GROUND: Final = 32


def captioned(caption: str, picture: Picture) -> Picture:
    """A picture below its caption."""
    strip = np.full((CAPTION_PX, picture.shape[1], 3), _GROUND, np.uint8)
    write(strip, caption, _CORNER, _WHITE, [])
    return np.vstack([strip, picture])


def tile_of(before: Picture, after: Picture, caption: str) -> Picture:
    """A small picture of a frame before and after, below its caption."""
    pair, width = np.hstack([before, after]), _TILE_WIDTH_PX - _GAP_PX
    height = max(1, round(pair.shape[0] * width / pair.shape[1]))
    small = cv2.resize(pair, (width, height), interpolation=cv2.INTER_AREA)
    tile = captioned(caption, small.astype(np.uint8, copy=False))
    gap = ((0, _GAP_PX), (0, _GAP_PX), (0, 0))  # to the next ones
    return np.pad(tile, gap, constant_values=_GROUND)


def sheet_of(tiles: Sequence[Picture]) -> Picture | None:
    """The contact sheet: tiles in four columns; None without any."""
    if not tiles:
        return None
    columns = min(_COLUMNS, len(tiles))
    height = max(len(tile) for tile in tiles)
    rows = -(-len(tiles) // columns)
    size = (rows * height, columns * _TILE_WIDTH_PX, 3)
    sheet: Picture = np.full(size, _GROUND, np.uint8)
    for number, tile in enumerate(tiles):
        top, left = number // columns * height, number % columns * _TILE_WIDTH_PX
        sheet[top : top + len(tile), left : left + _TILE_WIDTH_PX] = tile
    return sheet


def figure_of(
    key: str, name: str, words: str, rows: Iterable[tuple[str, str]], *, side: str = ""
) -> str:
    """The part of a page about one frame.

    Parameters
    ----------
    key : str
        Of the frame.
    name : str
        Of its pictures, in ``before/`` and ``after/``.
    words : str
        Its counts.
    rows : iterable of (box, reason)
        Of the boxes that are not kept.
    side : str
        A folder with another picture of it; empty without.
    """
    key, name = escape(key), quote(name)
    listed = "".join(f"<li><b>{escape(b)}</b> {escape(why)}</li>" for b, why in rows)
    more = f' <a href="{side}/{name}">All pictures</a>' if side else ""
    return f"""<figure>
<figcaption><b>{key}</b>: {escape(words)}{more}
</figcaption>
<div class="pair"><img src="before/{name}" alt="{key} before" loading="lazy">
<img class="after" src="after/{name}" alt="{key} after" loading="lazy"></div>
<label>before <input type="range" min="0" max="100" value="50"
 aria-label="{key}: from before to after"> after</label>
<details><summary>Boxes that are not kept, and why</summary><ul>{listed}</ul></details>
</figure>"""


def page_of(name: str, figures: Sequence[str], reasons: Counter[str]) -> str:
    """An HTML page: `figures` (`figure_of`), and the boxes not kept by reason."""
    listed = ", ".join(
        f"{escape(reason.replace('_', ' '))} {count}"
        for reason, count in reasons.most_common()
    )
    count = "1 frame" if len(figures) == 1 else f"{len(figures)} frames"
    return _HTML.format(
        title=escape(f"{name}: before and after"),
        summary=f"{count}. Boxes that are not kept: {listed or 'none'}.",
        figures="\n".join(figures),
    )


_HTML: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark }}
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1100px;
  padding: 0 1rem }}
figure {{ margin: 0 0 3rem }}
.pair {{ position: relative; --at: 50% }}
.pair img {{ display: block; width: 100% }}
.pair .after {{ position: absolute; inset: 0; clip-path: inset(0 0 0 var(--at)) }}
.pair::after {{ content: ""; position: absolute; top: 0; bottom: 0; left: var(--at);
  border-left: 2px solid #fff }}
label {{ display: flex; gap: .75rem; padding: .5rem 0 }}
input {{ flex: 1 }}
</style></head><body>
<h1>{title}</h1>
<p>{summary} <a href="sheet.png">Contact sheet</a></p>
<p>Left of the line are all boxes, right of it those that are kept.</p>
{figures}
<script>
for (const slider of document.querySelectorAll("input[type=range]")) {{
  const pair = slider.closest("figure").querySelector(".pair");
  const move = () => pair.style.setProperty("--at", `${{100 - slider.value}}%`);
  slider.addEventListener("input", move);
  pair.addEventListener("pointermove", (event) => {{
    if (event.buttons === 0 && event.pointerType !== "mouse") return;
    const box = pair.getBoundingClientRect();
    slider.value = 100 - (100 * (event.clientX - box.left)) / box.width;
    move();
  }});
  move();
}}
</script></body></html>
"""

// @ts-check
// One row of crops. Cells are drawn again only when something of their own has changed.

import { Component, html, useMemo } from "../html.js";
import { cropUrl } from "../calls/boxes.js";
import { boxIn, cropRequest, placed } from "../grid/placing.js";
import { matchText, reasonText, spokenText } from "../wording.js";
import { AnswerSign } from "./boxlist.js";
import { useCrop } from "./crop_cache.js";
import { Icon } from "./icons.js";
import { StrokeSwatch } from "./parts.js";

/** Below this there is no room for two things on one line. */
const SMALL_PX = 112;

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../types.js").Decision} Decision */
/** @typedef {import("../grid/layout.js").Layout} Layout */
/** @typedef {import("../grid/placing.js").Size} Size */
/** @typedef {{index: number, id: number | undefined, box: Decision | null | undefined, isSelected: boolean, isFocused: boolean}} CellState */
/** @typedef {(event: MouseEvent, index: number) => void} OnPick */

/**
 * @typedef {{app: App, row: number, top: number, layout: Layout, frameSize: Size | null, waiting: ReadonlySet<number>, cells: readonly CellState[],
 *   onPick: OnPick, onOpen: (index: number) => void}} RowProps
 */

/** @param {RowProps} props */
export function Row({ app, row, top, layout, frameSize, waiting, cells, onPick, onOpen }) {
  return html`<div class="grid-row ${layout.cell < SMALL_PX ? "is-small" : ""}" role="row" aria-rowindex=${row + 1} style=${{ transform: `translateY(${top}px)`, gridTemplateColumns: `repeat(${layout.columns}, ${layout.cell}px)` }}>
    ${cells.map(
      (cell, column) => html`<${Cell} key=${cell.index} app=${app} cell=${cell} column=${column} size=${layout.cell} frameSize=${frameSize}
        isWaiting=${cell.id !== undefined && waiting.has(cell.id)} onPick=${onPick} onOpen=${onOpen} />`,
    )}
  </div>`;
}

/** @typedef {{app: App, cell: CellState, column: number, size: number, frameSize: Size | null, isWaiting: boolean, onPick: OnPick, onOpen: (index: number) => void}} CellProps */

/** @extends {Component<CellProps>} */
class Cell extends Component {
  /** @param {CellProps} next */
  shouldComponentUpdate(next) {
    const { cell, size, frameSize, isWaiting, onPick } = this.props;
    const isSame = cell.id === next.cell.id && cell.box === next.cell.box && cell.isSelected === next.cell.isSelected && cell.isFocused === next.cell.isFocused;
    // A click counts from the selection as it is now.
    return !isSame || size !== next.size || frameSize !== next.frameSize || isWaiting !== next.isWaiting || onPick !== next.onPick;
  }

  /** @param {CellProps} props */
  render({ app, cell, column, size, frameSize, isWaiting, onPick, onOpen }) {
    const { id, box, index, isSelected, isFocused } = cell;
    const flags = `${isSelected ? "is-selected" : ""} ${isFocused ? "is-focused" : ""}`;
    return html`<div class="cell ${flags}" role="gridcell" id=${id === undefined ? undefined : `cell-${id}`} aria-selected=${isSelected} aria-colindex=${column + 1} data-index=${index}
      onClick=${(/** @type {MouseEvent} */ event) => onPick(event, index)} onDblClick=${() => onOpen(index)}>
      <span class="sr-only">${box ? spokenText(box) : box === null ? "Loading" : "Not found by the filters any more"}</span>
      <div class="cell__picture" aria-hidden="true" style=${{ height: `${size}px` }}>
        ${box && html`<${Picture} app=${app} box=${box} size=${size} frameSize=${frameSize} />`}
        ${box === null && html`<div class="cell__none shimmer" />`}
        ${box === undefined && html`<div class="cell__none">gone from this list</div>`}
        ${box && html`<${Marks} box=${box} isWaiting=${isWaiting} onOpen=${() => onOpen(index)} />`}
      </div>
      ${box ? html`<${Caption} box=${box} />` : html`<div class="cell__caption" />`}
    </div>`;
  }
}

/** @param {{box: Decision}} props */
function Caption({ box }) {
  return html`<div class="cell__caption" aria-hidden="true">
    <span class="cell__class"><${StrokeSwatch} verdict=${box.effective_verdict} /><span>${box.class}</span></span>
    <span class="cell__percent num">${matchText(box)}</span>
    <span class="cell__reason">${reasonText(box.reason)}</span>
  </div>`;
}

/** @param {{box: Decision, isWaiting: boolean, onOpen: () => void}} props */
function Marks({ box, isWaiting, onOpen }) {
  /** @param {Event} event */
  const open = (event) => {
    event.stopPropagation();
    onOpen();
  };
  return html`<span class="cell__tick" aria-hidden="true"><${Icon} name="check" class="icon--bold" /></span>
    ${box.toss_up && html`<span class="cell__tossup" title="A toss-up: too few pixels to tell">±</span>`}
    <span class="cell__answer" aria-hidden="true"><${AnswerSign} box=${box} isWaiting=${isWaiting} /></span>
    <button class="cell__open" tabindex="-1" aria-hidden="true" title="Open in its frame (C)" onClick=${open} onDblClick=${(/** @type {Event} */ event) => event.stopPropagation()}><${Icon} name="fit" /></button>`;
}

/** @param {{app: App, box: Decision, size: number, frameSize: Size | null}} props */
export function Picture({ app, box, size, frameSize }) {
  const { xyxy, box_id } = box;
  const ask = xyxy ? cropRequest(xyxy, size, devicePixelRatio || 1) : null;
  const { state, crop } = useCrop(app, ask ? cropUrl(box_id, ask) : "");
  const places = useMemo(
    () => (xyxy && ask && crop ? placed(xyxy, ask.pad, size, crop, frameSize) : null),
    [crop, size, frameSize, ask?.pad, box_id],
  );
  if (!xyxy) return html`<div class="cell__none"><${Icon} name="image" /><span>${box.reason === "outside_image" ? "outside" : "no area"}</span></div>`;
  const outline = html`<span class="cell__box cell__box--${box.effective_verdict}" style=${px(places?.box ?? boxIn(xyxy, size))} />`;
  if (!places || !crop) return html`<div class="cell__none cell__none--low ${state === "waiting" ? "shimmer" : ""}">${state === "waiting" ? "" : state === "failed" ? "not loaded" : "no picture"}</div>${outline}`;
  return html`<img class="cell__image" src=${crop.src} alt="" draggable=${false} style=${px(places.picture)} />${outline}`;
}

/** @param {import("../grid/placing.js").Place} place */
const px = ({ left, top, width, height }) => ({ left: `${left}px`, top: `${top}px`, width: `${width}px`, height: `${height}px` });

// @ts-check
// The cells of the grid. Only rows in or near the visible part are in the document.

import { asShown } from "../boxes/box.js";
import { Picture } from "../boxes/crops.js";
import { AnswerSign, StrokeSwatch } from "../boxes/signs.js";
import { matchText, reasonText, spokenText } from "../boxes/wording.js";
import { useActions, useValue } from "../core/hooks.js";
import { Component, html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { useKeyText, withKey } from "../core/keymap.js";
import { MiddleCut } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import {
  HEAD_PX,
  MOVES,
  cellsIn,
  layoutOf,
  moved,
  offsetAt,
  offsetToShow,
  rowsInSight,
  scrollTopFor,
} from "./layout.js";
import { createPicking, extended, focused, isSelected, lassoed, listenToLasso } from "./selection.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { Size } from "../boxes/crops.js" */
/** @import { ReviewApp as App } from "../review/answers.js" */
/** @import { GridActions } from "./grid.js" */
/** @import { Layout, Move, Rect } from "./layout.js" */
/** @import { Place } from "./pager.js" */

const SPARE_ROWS = 2;
const PADDING_PX = 16;

/** @param {{app: App, place: Place, frameSize: Size | null, actions: GridActions}} props */
export function GridCells({ app, place, frameSize, actions }) {
  const { pager } = place;
  const selection = place.selection.get();
  const host = useRef(/** @type {HTMLDivElement | null} */ (null));
  const { cropSize, blind } = useValue(app.prefs);
  const [view, setView] = useState({ width: 0, height: 0, scrollTop: 0 });
  const [lasso, setLasso] = useState(/** @type {Rect | null} */ (null));
  const width = Math.max(0, view.width - 2 * PADDING_PX);
  const layout = layoutOf({ count: pager.count(), width, size: cropSize });
  const offset = offsetAt(layout, view.scrollTop, view.height);
  const sight = rowsInSight(layout, offset, view.height, SPARE_ROWS);
  const now = useRef({ layout, offset, view });
  now.current = { layout, offset, view };

  useMeasures(host, place, now, setView);
  useEffect(
    () => pager.want(sight.first * layout.columns, sight.end * layout.columns),
    [sight.first, sight.end, layout.columns, pager],
  );

  useKeysOfGrid(app, host, { place, now, actions });
  useLasso(host, { place, now, setLasso });

  const { onPick, onOpen } = useMemo(() => createPicking(place, actions), [place, actions]);
  const rows = Array.from({ length: Math.max(0, sight.end - sight.first) }, (_, i) => sight.first + i);
  const waiting = app.sender.state.get().waitingInBulk;
  const openTitle = withKey("Open in its frame", useKeyText(app, "open"));
  const focusId = pager.idAt(selection.focus);
  return html`<div class="grid-scroll" ref=${host} tabindex="0" role="grid" aria-label="Boxes"
    aria-multiselectable="true" data-known=${pager.known()}
    aria-rowcount=${layout.rows} aria-colcount=${layout.columns} aria-busy=${pager.known() === 0}
    aria-activedescendant=${focusId === undefined ? undefined : `cell-${focusId}`}>
    <div class="grid-space" role="presentation" style=${{ height: `${layout.height}px` }}>
      ${rows.map(
        (
          row,
        ) => html`<${Row} key=${row} app=${app} row=${row} top=${HEAD_PX + row * layout.pitch + view.scrollTop - offset}
          layout=${layout} frameSize=${frameSize} waiting=${waiting}
          cells=${Array.from({ length: Math.min(layout.columns, layout.count - row * layout.columns) }, (_, i) =>
            cellAt(place, row * layout.columns + i, blind),
          )} openTitle=${openTitle} onPick=${onPick} onOpen=${onOpen} />`,
      )}
      ${lasso && html`<div class="lasso" role="presentation" style=${placeOf(lasso, view.scrollTop - offset)} />`}
    </div>
  </div>`;
}

/** @param {Place} place @param {number} index @param {boolean} isBlind @returns {CellState} */
function cellAt({ pager, selection }, index, isBlind) {
  const now = selection.get();
  const id = pager.idAt(index);
  const box = pager.at(index);
  return {
    index,
    id,
    box: box && asShown(box, isBlind),
    isSelected: id === undefined ? now.all : isSelected(now, id),
    isFocused: index === now.focus,
  };
}

/** @param {Rect} rect @param {number} shift */
const placeOf = ({ x0, y0, x1, y1 }, shift) => ({
  left: `${Math.min(x0, x1) + PADDING_PX}px`,
  top: `${Math.min(y0, y1) + HEAD_PX + shift}px`,
  width: `${Math.abs(x1 - x0)}px`,
  height: `${Math.abs(y1 - y0)}px`,
});

/**
 * @typedef {{current: {layout: Layout, offset: number, view: {width: number, height: number, scrollTop: number}}}} Now
 */

/**
 * How large the view is and how far it is scrolled; the same boxes stay visible when its size changes.
 * @param {{current: HTMLDivElement | null}} host @param {Place} place @param {Now} now
 * @param {(change: (view: Now["current"]["view"]) => Now["current"]["view"]) => void} setView
 */
function useMeasures(host, place, now, setView) {
  const { layout, view } = now.current;
  useLayoutEffect(() => {
    const element = /** @type {HTMLDivElement} */ (host.current);
    const measure = () => setView((last) => ({ ...last, width: element.clientWidth, height: element.clientHeight }));
    const scroll = () => setView((last) => ({ ...last, scrollTop: element.scrollTop }));
    const resizes = new ResizeObserver(measure);
    resizes.observe(element);
    element.addEventListener("scroll", scroll, { passive: true });
    measure();
    return () => {
      resizes.disconnect();
      element.removeEventListener("scroll", scroll);
    };
  }, []);
  const anchor = useRef(place.scroll.offset);
  const shape = view.width ? `${layout.columns} ${layout.pitch}` : "";
  useLayoutEffect(() => {
    if (!shape || !host.current) return;
    host.current.scrollTop = scrollTopFor(layout, (anchor.current * layout.pitch) / layout.columns, view.height);
  }, [shape]);
  useLayoutEffect(() => {
    if (!shape) return;
    // Counted in cells: it still means the same when columns are more or fewer.
    anchor.current = (now.current.offset / layout.pitch) * layout.columns;
    place.scroll.offset = anchor.current;
    place.scroll.seen = Date.now();
  }, [view.scrollTop, place]);
  useEffect(() => () => void (place.scroll.seen = Date.now()), [place]);
}

/**
 * The keyboard actions that move through the grid.
 * @param {App} app @param {{current: HTMLDivElement | null}} host
 * @param {{place: Place, now: Now, actions: GridActions}} grid
 */
function useKeysOfGrid(app, host, { place, now, actions }) {
  const byName = useMemo(() => {
    const { pager, selection } = place;
    /** @param {number} index @param {boolean} [isSpan] */
    const go = (index, isSpan = false) => {
      const element = /** @type {HTMLDivElement} */ (host.current);
      const { layout, view } = now.current;
      const before = selection.get();
      selection.set(isSpan ? extended(before, index, pager.idsBetween(before.anchor, index)) : focused(before, index));
      const offset = offsetAt(layout, element.scrollTop, view.height);
      element.scrollTop = scrollTopFor(layout, offsetToShow(layout, index, offset, view.height), view.height);
    };
    /** @param {Move} move */
    const to = (move) => (/** @type {{shiftKey: boolean} | undefined} */ press) => {
      const { layout, view } = now.current;
      const page = Math.max(1, Math.floor(view.height / layout.pitch));
      go(moved(layout, selection.get().focus, move, page), press?.shiftKey);
    };
    place.show = go;
    const moves = Object.fromEntries(MOVES.map((move) => [move, to(move)]));
    return { ...moves, select: () => actions.toggle(selection.get().focus), selectAll: actions.all };
  }, [place, actions]);
  useActions(app, byName);
}

/**
 * @param {{current: HTMLDivElement | null}} host
 * @param {{place: Place, now: Now, setLasso: (rect: Rect | null) => void}} grid
 */
function useLasso(host, { place, now, setLasso }) {
  useEffect(() => {
    const element = /** @type {HTMLDivElement} */ (host.current);
    const { pager, selection } = place;
    let before = selection.get();
    return listenToLasso(element, {
      corner: () => ({
        left: PADDING_PX,
        top: HEAD_PX - offsetAt(now.current.layout, element.scrollTop, now.current.view.height),
      }),
      begin: () => void (before = selection.get()),
      change(rect, adds) {
        const inside = cellsIn(now.current.layout, rect);
        const ids = inside.map((index) => pager.idAt(index)).filter((id) => id !== undefined);
        setLasso(rect);
        selection.set(lassoed(before, ids, inside.at(-1) ?? before.focus, adds));
      },
      end: () => setLasso(null),
    });
  }, [place]);
}

/** Below this there is no room for two things on one line. */
const SMALL_PX = 112;

/**
 * @typedef {{index: number, id: number | undefined, box: Decision | null | undefined, isSelected: boolean, isFocused:
 *   boolean}} CellState
 */
/** @typedef {(event: MouseEvent, index: number) => void} OnPick */

/**
 * @typedef {{app: App, row: number, top: number, layout: Layout, frameSize: Size | null, waiting: ReadonlySet<number>,
 *   cells: readonly CellState[], openTitle: string, onPick: OnPick, onOpen: (index: number) => void}} RowProps
 */

/** @param {RowProps} props */
function Row({ app, row, top, layout, frameSize, waiting, cells, openTitle, onPick, onOpen }) {
  return html`<div class="grid-row ${layout.cell < SMALL_PX ? "is-small" : ""}" role="row" aria-rowindex=${row + 1}
    style=${{ transform: `translateY(${top}px)`, gridTemplateColumns: `repeat(${layout.columns}, ${layout.cell}px)` }}>
    ${cells.map(
      (cell, column) => html`<${Cell} key=${cell.index} app=${app} cell=${cell} column=${column} size=${layout.cell}
        frameSize=${frameSize}
        isWaiting=${cell.id !== undefined && waiting.has(cell.id)} openTitle=${openTitle} onPick=${onPick}
        onOpen=${onOpen} />`,
    )}
  </div>`;
}

/**
 * @typedef {{app: App, cell: CellState, column: number, size: number, frameSize: Size | null, isWaiting: boolean,
 *   openTitle: string, onPick: OnPick, onOpen: (index: number) => void}} CellProps
 */

/** @extends {Component<CellProps>} */
class Cell extends Component {
  /** @param {CellProps} next */
  shouldComponentUpdate(next) {
    const { cell, size, frameSize, isWaiting, openTitle, onPick } = this.props;
    const isSame =
      cell.id === next.cell.id &&
      cell.box === next.cell.box &&
      cell.isSelected === next.cell.isSelected &&
      cell.isFocused === next.cell.isFocused;
    // A click counts from the selection as it is now.
    return (
      !isSame ||
      size !== next.size ||
      frameSize !== next.frameSize ||
      isWaiting !== next.isWaiting ||
      openTitle !== next.openTitle ||
      onPick !== next.onPick
    );
  }

  /** @param {CellProps} props */
  render({ app, cell, column, size, frameSize, isWaiting, openTitle, onPick, onOpen }) {
    const { id, box, index, isSelected, isFocused } = cell;
    const flags = `${isSelected ? "is-selected" : ""} ${isFocused ? "is-focused" : ""}`;
    return html`<div class="cell ${flags}" role="gridcell" id=${id === undefined ? undefined : `cell-${id}`}
      aria-selected=${isSelected} aria-colindex=${column + 1} data-index=${index}
      onClick=${(/** @type {MouseEvent} */ event) => onPick(event, index)} onDblClick=${() => onOpen(index)}>
      <span class="sr-only">
        ${box ? `${spokenText(box)}, frame ${box.frame}` : box === null ? "Loading" : "No longer matches the filters"}
      </span>
      <div class="cell__picture" aria-hidden="true" style=${{ height: `${size}px` }}>
        ${box && html`<${Picture} box=${box} size=${size} frameSize=${frameSize} />`}
        ${box === null && html`<div class="cell__none shimmer" />`}
        ${box === undefined && html`<div class="cell__none">no longer matches</div>`}
        ${
          box &&
          html`<${Marks} box=${box} isWaiting=${isWaiting} openTitle=${openTitle} onOpen=${() => onOpen(index)} />`
        }
      </div>
      ${box ? html`<${Caption} box=${box} />` : html`<div class="cell__caption" />`}
    </div>`;
  }
}

/** A click on a link or a button does not select the cell. @param {Event} event */
const stop = (event) => event.stopPropagation();

/** @param {{box: Decision}} props */
function Caption({ box }) {
  return html`<div class="cell__caption" aria-hidden="true">
    <span class="cell__class"><${StrokeSwatch} verdict=${box.effective_verdict} /><span>${box.class}</span></span>
    <span class="cell__percent num">${matchText(box)}</span>
    <span class="cell__reason">${reasonText(box.reason)}</span>
    <a class="cell__frame" href=${linkTo("frame", { id: box.frame_id }, { box: String(box.box_id) })} tabindex="-1"
      draggable=${false} title=${`Frame ${box.frame}`} onClick=${stop}
      onDblClick=${stop}><${MiddleCut} text=${box.frame} /></a>
  </div>`;
}

/** @param {{box: Decision, isWaiting: boolean, openTitle: string, onOpen: () => void}} props */
function Marks({ box, isWaiting, openTitle, onOpen }) {
  /** @param {Event} event */
  const open = (event) => {
    stop(event);
    onOpen();
  };
  return html`<span class="cell__tick" aria-hidden="true"><${Icon} name="check" class="icon--bold" /></span>
  ${box.toss_up && html`<span class="cell__tossup" title="A toss-up: too few pixels to be certain">±</span>`}
  <span class="cell__answer" aria-hidden="true"><${AnswerSign} box=${box} isWaiting=${isWaiting} /></span>
  <button class="cell__open" tabindex="-1" aria-hidden="true" title=${openTitle} onClick=${open}
    onDblClick=${stop}><${Icon} name="fit" /></button>`;
}

// @ts-check
// The boxes of a frame as a list, with filters.

import { FilterMenus, VERDICT_CHOICES, VerdictFilter } from "../boxes/filter_bar.js";
import { LIST_ORDERS, countsBy, withoutFrameFilters } from "../boxes/filters.js";
import { AnswerSign, StrokeSwatch } from "../boxes/signs.js";
import { matchText, reasonText } from "../boxes/wording.js";
import { Component, html, useEffect, useRef } from "../core/html.js";
import { countOf, countText } from "../core/numbers.js";
import { Select } from "../core/parts.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { Query } from "../core/router.js" */

/**
 * @param {{boxes: readonly Decision[], shown: readonly Decision[], selected: Decision | null, query: Query,
 *   waiting: ReadonlySet<number>, onSelect: (boxId: number | null) => void, onQuery: (query: Query) => void}} props
 */
export function BoxList({ boxes, shown, selected, query, waiting, onSelect, onQuery }) {
  const hidden = boxes.length - shown.length;
  const list = useRef(/** @type {HTMLUListElement | null} */ (null));
  useEffect(
    () => list.current?.querySelector("[aria-selected=true]")?.scrollIntoView({ block: "nearest" }),
    [selected?.box_id],
  );
  /** @param {KeyboardEvent} event */
  const onKeyDown = (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step || listed.length === 0) return;
    event.preventDefault();
    const at = listed.findIndex((box) => box === selected);
    onSelect(listed[Math.min(Math.max(at + step, 0), listed.length - 1)]?.box_id ?? null);
  };
  const listed =
    selected && !shown.includes(selected) ? boxes.filter((box) => box === selected || shown.includes(box)) : shown;
  return html`<aside class="panel panel--list" aria-label="Boxes">
    <${Filters} boxes=${boxes} query=${query} onQuery=${onQuery} />
    <p class="panel__count" role="status">
      <span>${countOf(shown.length, "box", "boxes")}</span>
      ${
        hidden > 0 &&
        html`<span class="panel__hidden">${countText(hidden)} hidden
          <button class="button button--quiet button--small"
            onClick=${() => onQuery(withoutFrameFilters(query))}>Show all</button></span>`
      }
    </p>
    ${boxes.length === 0 && html`<p class="panel__empty">This frame has no boxes.</p>`}
    <ul class="boxes" role="listbox" aria-label="Boxes of this frame" tabindex="0" ref=${list}
      onKeyDown=${onKeyDown} aria-activedescendant=${selected ? `box-${selected.box_id}` : undefined}>
      ${listed.map(
        (box) => html`<${Row} key=${box.box_id} box=${box} isSelected=${box === selected}
          isWaiting=${waiting.has(box.box_id)} onSelect=${onSelect} />`,
      )}
    </ul>
  </aside>`;
}

/** @param {{boxes: readonly Decision[], query: Query, onQuery: (query: Query) => void}} props */
function Filters({ boxes, query, onQuery }) {
  const verdicts = countsBy(boxes, "verdict");
  const choices = VERDICT_CHOICES.filter(({ value }) => verdicts.has(value) || query.verdict === value).map(
    ({ value }) => ({
      value,
      text: html`<${StrokeSwatch} verdict=${value} /><span class="num">${verdicts.get(value) ?? 0}</span>
      <span class="sr-only">${value}</span>`,
    }),
  );
  const own = {
    reason: { choices: counted(countsBy(boxes, "reason"), reasonText) },
    class: { choices: counted(countsBy(boxes, "class"), String) },
  };
  return html`<div class="panel__filters" role="search" aria-label="Filter boxes">
    <${VerdictFilter} query=${query} choices=${choices} onChange=${onQuery} />
    <div class="panel__selects"><${FilterMenus} query=${query} own=${own} onChange=${onQuery} />
      <${Select} label="Order" any="As they came in" value=${query.by ?? ""} choices=${LIST_ORDERS}
        onChange=${(/** @type {string} */ by) => onQuery({ ...query, by })} /></div>
  </div>`;
}

/** @param {Map<string, number>} counts @param {(value: string) => string} words */
const counted = (counts, words) => [...counts].map(([value, n]) => ({ value, text: `${words(value)} (${n})` }));

/** @typedef {{box: Decision, isSelected: boolean, isWaiting: boolean, onSelect: (boxId: number) => void}} RowProps */

/** Drawn again only when its own box has changed: a frame may have hundreds. @extends {Component<RowProps>} */
class Row extends Component {
  /** @param {RowProps} next */
  shouldComponentUpdate(next) {
    const { box, isSelected, isWaiting } = this.props;
    return box !== next.box || isSelected !== next.isSelected || isWaiting !== next.isWaiting;
  }

  /** @param {RowProps} props */
  render({ box, isSelected, isWaiting, onSelect }) {
    return html`<li id=${`box-${box.box_id}`} class="box" role="option" aria-selected=${isSelected}
      onClick=${() => onSelect(box.box_id)}>
      <${StrokeSwatch} verdict=${box.effective_verdict} />
      <span class="box__text">
        <span class="box__name">${box.class} <span class="faint">${box.id}</span></span>
        <span
          class="box__reason">${reasonText(box.reason)}<span class="sr-only">, ${box.effective_verdict}</span></span>
      </span>
      <span class="box__side">
        <span class="num">${matchText(box)}</span>
        <${AnswerSign} box=${box} isWaiting=${isWaiting} />
      </span>
    </li>`;
  }
}

// @ts-check
// The same object in the frames of its recording before and after: to look at, and to answer in all of them.

import { Picture } from "../boxes/crops.js";
import { AnswerSign } from "../boxes/signs.js";
import { spokenText } from "../boxes/wording.js";
import { get } from "../core/api.js";
import { useLoaded } from "../core/hooks.js";
import { html, useEffect, useRef } from "../core/html.js";
import { useKeyText, withKey } from "../core/keymap.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { Boxes } from "../boxes/store.js" */
/** @import { Actions } from "../core/app.js" */
/** @import { ReviewApp } from "../review/answers.js" */
/** @typedef {{boxId: number, offset: number}} Place  a box of the object, and how many frames later it is */

/** @type {readonly Place[]} */
const NONE = [];

/**
 * While the places of a box are loaded, if the box before it had some: their strip keeps its room.
 * @type {readonly Place[]}
 */
const EXPECTED = [];

/**
 * The places of the object of a box, in order, once they are loaded; none if it is in no other frame.
 * @param {Boxes} boxes @param {number} boxId  0: of no box
 */
export function useTrack(boxes, boxId) {
  const { value } = useLoaded(
    async (signal) => {
      const { items } = boxId
        ? await get("/api/v1/boxes/{box_id}/track", { path: { box_id: boxId }, signal })
        : { items: [] };
      const ids = boxes.receive(items.map(({ offset: _, ...box }) => box));
      return { boxId, places: ids.map((id, i) => ({ boxId: id, offset: items[i]?.offset ?? 0 })) };
    },
    [boxes, boxId],
  );
  const isLoaded = value?.boxId === boxId;
  const places = !value || value.places.length < 2 ? NONE : isLoaded ? value.places : EXPECTED;
  useEffect(() => boxes.hold(places.map((place) => place.boxId)), [boxes, places]);
  return places;
}

const NUMBERS = ["no", "one", "two", "three", "four", "five"];

/** @param {number} count */
const framesText = (count) => `${NUMBERS[count] ?? count} frame${count === 1 ? "" : "s"}`;

/**
 * Where the object is visible nearest to the asked frame: "visible two frames ago".
 * @param {readonly {offset: number, box: Decision}[]} places
 */
export function seenText(places) {
  const seen = places
    .filter(({ offset, box }) => offset !== 0 && box.effective_verdict === "kept")
    .map(({ offset }) => offset);
  const before = seen.filter((offset) => offset < 0).at(-1);
  const after = seen.find((offset) => offset > 0);
  const words = [before && `visible ${framesText(-before)} ago`, after && `visible ${framesText(after)} later`];
  return words.filter(Boolean).join(", ") || "visible in none of these frames";
}

const SIZE_PX = 64;

/**
 * @param {{app: ReviewApp, places: readonly Place[], shownId: number, see: (box: Decision) => Decision, isBlind:
 *   boolean, onShow: (boxId: number) => void, actions: Actions}} props `shownId`: of the box on the stage
 */
export function TrackStrip({ app, places, shownId, see, isBlind, onShow, actions }) {
  const keys = { keepTrack: useKeyText(app, "keepTrack"), rejectTrack: useKeyText(app, "rejectTrack") };
  const list = useRef(/** @type {HTMLOListElement | null} */ (null));
  useEffect(
    () => list.current?.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest", inline: "nearest" }),
    [shownId, places],
  );
  const boxes = places.flatMap(({ boxId, offset }) => {
    const box = app.boxes.get(boxId);
    return box ? [{ offset, box: isBlind ? see(box) : box }] : [];
  });
  if (places === EXPECTED) return html`<div class="track" aria-hidden="true"></div>`;
  if (boxes.length < 2) return null;
  return html`<div class="track">
    <p class="track__words">${isBlind ? "The same object before and after" : seenText(boxes)}</p>
    <ol class="track__boxes" ref=${list} aria-label="The same object in other frames">
      ${boxes.map(
        ({ box, offset }) => html`<li key=${box.box_id}>
          <button class="track__box" aria-current=${box.box_id === shownId ? "true" : undefined}
            onClick=${() => onShow(box.box_id)}>
            <${Picture} box=${box} size=${SIZE_PX} frameSize=${null} />
            <span class="track__offset num">${offset > 0 ? `+${offset}` : offset === 0 ? "0" : `−${-offset}`}
              <span class="sr-only"> frames: ${spokenText(box)}</span></span>
            ${!isBlind && html`<span class="cell__answer"><${AnswerSign} box=${box} isWaiting=${false} /></span>`}
          </button>
        </li>`,
      )}
    </ol>
    <p class="track__answers">
      <button class="button button--small" title=${withKey("Keep the object in all of these frames", keys.keepTrack)}
        onClick=${actions.keepTrack}>Keep all</button>
      <button class="button button--small"
        title=${withKey("Reject the object in all of these frames", keys.rejectTrack)}
        onClick=${actions.rejectTrack}>Reject all</button>
    </p>
  </div>`;
}

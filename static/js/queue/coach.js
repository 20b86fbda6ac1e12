// @ts-check
// The lesson of a queue: boxes whose truth is known. After an answer, one sentence says whether it was right, and why.

import { answerOf, isWithheld } from "../boxes/box.js";
import { distanceText } from "../boxes/wording.js";
import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { useKeyText } from "../core/keymap.js";
import { countOf, countText, wholePercentText } from "../core/numbers.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { App } from "../core/app.js" */
/** @import { Hider } from "./question.js" */

/**
 * @typedef {object} Lesson
 * @property {number} at  number of the box on show, from 1
 * @property {number} count  how many boxes the lesson has
 * @property {() => void} onNext
 * @property {() => void} onSkip
 */

/** From this share of a box on, a tag is named among what is seen in it. */
const NAMED_PERCENT = 20;
const MOST_NAMED = 2;

/** From this share of its pixels on, a box shows an object of its class. */
const MOSTLY_PERCENT = 50;

/** An object of which so little of the box is seen is said to be enough. */
const LITTLE_PERCENT = 25;

/** Whether the object of a box of a lesson is seen. @param {Decision} box */
const isSeen = ({ visible_pixels: pixels }) => (pixels ?? 0) > 0;

/**
 * Whether an answer on a box of a lesson is right; an unsure one is neither.
 * @param {Decision} box @param {string | null} answer
 */
const isRight = (box, answer) => answer === (isSeen(box) ? "keep" : "reject");

/**
 * What is known about a box of a lesson that was answered: whether the answer is right, and why.
 * @param {Decision} box @param {Hider} hider
 */
function toldText(box, hider) {
  const answer = answerOf(box);
  const name = box.class.replaceAll("_", " ");
  const pixels = box.box_pixels ?? 0;
  if (isSeen(box)) {
    const percent = (100 * (box.visible_pixels ?? 0)) / Math.max(pixels, 1);
    const seen = `${countOf(box.visible_pixels ?? 0, "pixel")} of this ${name} can be seen, ${wholePercentText(percent)} of its box.`;
    const rest = percent <= LITTLE_PERCENT ? " That is enough: what hides the rest does not count." : "";
    return `${isRight(box, answer) ? "Right, keep it:" : "Keep it:"} ${seen}${rest}`;
  }
  const none = `none of the ${countText(pixels)} pixels in the box is of this ${name}`;
  return `${isRight(box, answer) ? "Right, a ghost:" : "It is a ghost, reject it:"} ${none}.${insteadText(box, name, hider)}`;
}

/** What a box shows in place of its object. @param {Decision} box @param {string} name @param {Hider} hider */
function insteadText({ match_percent: match, hidden_by: tags }, name, hider) {
  const at = hider && distanceText(hider.box);
  if ((match ?? 0) >= MOSTLY_PERCENT) {
    const which = hider ? `, ${hider.box.class.replaceAll("_", " ")} ${hider.box.id}${at ? ` at ${at}` : ""}` : "";
    return ` The ${name} that you see is another one${which}.`;
  }
  const named = tags.filter(({ percent }) => percent >= NAMED_PERCENT).slice(0, MOST_NAMED);
  if (named.length === 0) return "";
  return ` They show ${named.map(({ name: tag, percent }) => `${tag.toLowerCase()} (${wholePercentText(percent)})`).join(" and ")}.`;
}

/**
 * Above the question: which box of the lesson it is, and after the answer what is known.
 * @param {{app: App, lesson: Lesson, box: Decision, hider: Hider}} props
 */
export function Coach({ app, lesson: { at, count, onNext, onSkip }, box, hider }) {
  const key = useKeyText(app, "next");
  const where = `Box ${at} of ${count}`;
  if (isWithheld(box)) {
    return html`<div class="coach">
      <p>
        <b>${where} to learn by.</b> The truth about ${
          at === 1 ? "these five is known" : "it is known"
        }: answer, and you are told why.</p>
      <button class="button button--small button--quiet" onClick=${onSkip}>Skip the lesson</button>
    </div>`;
  }
  const right = isRight(box, answerOf(box));
  return html`<div class="coach coach--${right ? "right" : "wrong"}">
    <p role="status"><${Icon} name=${right ? "check" : "warn"} /> <b>${where}.</b> ${toldText(box, hider)}
      ${at === count ? " From the next box on, nobody knows: your answers count." : ""}</p>
    <button class="button button--small button--primary" onClick=${onNext}>${at === count ? "To the queue" : "Next box"}
      ${key && html` <kbd aria-hidden="true">${key}</kbd>`}</button>
  </div>`;
}

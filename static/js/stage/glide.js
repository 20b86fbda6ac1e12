// @ts-check
// A view that moves to another one in a moment, or at once for those who want no motion.

/** @typedef {import("../geometry.js").View} View */

const DURATION_MS = 160;

/** @param {() => View} current @param {(view: View) => void} show */
export function createGlide(current, show) {
  /** @type {View | null} */
  let goal = null;
  let request = 0;

  function stop() {
    cancelAnimationFrame(request);
    goal = null;
  }

  /** @param {View} target @param {boolean} smoothly */
  function to(target, smoothly) {
    stop();
    if (!smoothly || matchMedia("(prefers-reduced-motion: reduce)").matches) {
      show(target);
      return;
    }
    goal = target;
    const from = current();
    const start = performance.now();
    /** @param {number} now */
    const step = (now) => {
      const share = Math.min(Math.max(0, now - start) / DURATION_MS, 1);
      show(between(from, target, 1 - (1 - share) ** 3));
      if (share < 1) request = requestAnimationFrame(step);
      else goal = null;
    };
    request = requestAnimationFrame(step);
  }

  return { to, stop, target: () => goal ?? current() };
}

/** Scale moves geometrically, so that zooming feels even. @param {View} a @param {View} b @param {number} share @returns {View} */
function between(a, b, share) {
  if (share === 1) return b;
  const scale = a.scale * (b.scale / a.scale) ** share;
  const same = Math.abs(b.scale - a.scale) < 1e-9;
  const t = same ? share : (scale - a.scale) / (b.scale - a.scale);
  return { scale, x: a.x + (b.x - a.x) * t, y: a.y + (b.y - a.y) * t };
}

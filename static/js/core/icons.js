// @ts-check
// Line icons.

import { html } from "./html.js";

/** @type {Record<string, string>} */
const PATHS = {
  check: "M3 8.5 6.5 12 13 4.5",
  cross: "M4 4l8 8M12 4l-8 8",
  question: "M5.8 6a2.2 2.2 0 1 1 3.3 1.9c-.8.5-1.1.9-1.1 1.8M8 12.2v.1",
  blind: "M2 8s2.3-4 6-4 6 4 6 4-2.3 4-6 4-6-4-6-4M8 6.2a1.8 1.8 0 1 1 0 3.6 1.8 1.8 0 0 1 0-3.6M2.5 13.5l11-11",
  settings:
    "M2 4.5h6M12 4.5h2M10 2.8a1.7 1.7 0 1 1 0 3.4 1.7 1.7 0 0 1 0-3.4M2 11.5h2M8 11.5h6M6 9.8a1.7 1.7 0 1 1 0 3.4 1.7 1.7 0 0 1 0-3.4",
  upload: "M8 10.5v-8M4.8 5.5 8 2.3l3.2 3.2M2.5 10.5v3h11v-3",
  undo: "M6 3.5 3 6.5l3 3M3.5 6.5h6a3.5 3.5 0 0 1 0 7H7",
  left: "M9.5 3.5 5 8l4.5 4.5",
  right: "M6.5 3.5 11 8l-4.5 4.5",
  layers: "M8 2.5 14 6 8 9.5 2 6zM2.5 9 8 12.5 13.5 9",
  light:
    "M8 2v1.2M8 12.8V14M2 8h1.2M12.8 8H14M3.8 3.8l.8.8M11.4 11.4l.8.8M12.2 3.8l-.8.8M4.6 11.4l-.8.8M8 5.2a2.8 2.8 0 1 1 0 5.6 2.8 2.8 0 0 1 0-5.6",
  fit: "M2.5 6V2.5H6M10 2.5h3.5V6M13.5 10v3.5H10M6 13.5H2.5V10",
  panels: "M2 3h12v10H2zM10 3v10",
  screen: "M2.5 2.5h11v8h-11zM5.5 13.5h5M6 6.5h4",
  slide: "M5.5 4.5 2 8l3.5 3.5M10.5 4.5 14 8l-3.5 3.5",
  halves: "M2 3h12v10H2zM8 1.5v13M10.5 6v4",
  far: "M2 13h6V7H2zM10.5 5h3V2h-3zM8 7l2.5-2",
  crop: "M4.5 1.5v10h10M1.5 4.5h10v10",
  plus: "M8 3v10M3 8h10",
  minus: "M3 8h10",
  cube: "M8 1.8 13.5 5v6L8 14.2 2.5 11V5zM2.5 5 8 8.2 13.5 5M8 8.2v6",
  grid: "M2.5 2.5h4v4h-4zM9.5 2.5h4v4h-4zM2.5 9.5h4v4h-4zM9.5 9.5h4v4h-4z",
  moon: "M13 9.6A5.5 5.5 0 1 1 6.4 3a4.4 4.4 0 0 0 6.6 6.6z",
  sun: "M8 1.5v1.4M8 13.1v1.4M1.5 8h1.4M13.1 8h1.4M3.4 3.4l1 1M11.6 11.6l1 1M12.6 3.4l-1 1M4.4 11.6l-1 1M8 5a3 3 0 1 1 0 6 3 3 0 0 1 0-6",
  system: "M2 3h12v8H2zM6 14h4M8 11v3",
  keyboard: "M1.5 4h13v8h-13zM4 6.5h.1M6.7 6.5h.1M9.3 6.5h.1M12 6.5h.1M4 9.5h.1M12 9.5h.1M6.2 9.5h3.6",
  exit: "M6.5 2.5h-4v11h4M10 5l3 3-3 3M13 8H6",
  comment: "M2.5 3h11v8H7l-3 2.5V11H2.5z",
  cloud: "M4.5 12a3 3 0 0 1-.3-6A4 4 0 0 1 12 7a2.5 2.5 0 0 1-.5 5zM2.5 2l11 12",
  warn: "M8 2.2 14.5 13.5h-13zM8 6.3v3.4M8 11.6v.1",
  copy: "M5.5 5.5h8v8h-8zM10.5 5.5v-3h-8v8h3",
  dots: "M3.5 8h.1M8 8h.1M12.5 8h.1",
  image: "M2 3h12v10H2zM2 11l3.5-3.5L9 11l2-2 3 3M10.5 6.2v.1",
  clock: "M8 2.2a5.8 5.8 0 1 1 0 11.6 5.8 5.8 0 0 1 0-11.6M8 4.8V8l2.3 1.5",
  play: "M5 3.2 12.5 8 5 12.8z",
  download: "M8 2.5v7.5M4.8 7 8 10.2 11.2 7M2.8 13.3h10.4",
  filter: "M2 3.5h12M4.5 8h7M6.5 12.5h3",
};

/** @param {{name: string, class?: string}} props */
export function Icon({ name, class: className = "" }) {
  return html`<svg class="icon ${className}" viewBox="0 0 16 16" aria-hidden="true" focusable="false">
    <path d=${PATHS[name] ?? ""} />
  </svg>`;
}

/** The mark of the product: a box that fades where nothing is behind it. */
export function Mark() {
  return html`<svg class="mark" viewBox="0 0 20 20" aria-hidden="true" focusable="false">
    <path class="mark__kept" d="M3 13V3h10" />
    <path class="mark__gone" d="M17 7v10H7" />
    <path class="mark__check" d="M6.5 10.2 9 12.7l5-5.4" />
  </svg>`;
}

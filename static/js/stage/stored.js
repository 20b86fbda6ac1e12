// @ts-check
// Image files as the server reads and draws them, which boxes refer to: opaque, and turned by EXIF only where the
// server does.

/**
 * @typedef {object} StoredImage
 * @property {Blob} file  without EXIF data, so that browsers show its stored pixels
 * @property {Blob} seen  with an orientation that the server applies, too, if that keeps the picture's size
 * @property {boolean} mayHaveAlpha
 */

const PNG = [0x89, 0x50, 0x4e, 0x47];

const JPEG = [0xff, 0xd8];

/** Chunks begin after the signature. */
const FIRST_CHUNK = 8;

/** The length, the name and the checksum of a chunk. */
const CHUNK_FRAME = 12;

/** Where the header has the type of the colours; 4 and 6 have an alpha channel. */
const COLOR_TYPE = 25;

/** @param {Blob} seen @returns {Promise<StoredImage>} */
export async function storedImage(seen) {
  const bytes = new DataView(await seen.arrayBuffer());
  if (startsWith(bytes, PNG)) return storedPng(seen, bytes);
  return { file: startsWith(bytes, JPEG) ? without(seen, jpegExif(bytes)) : seen, seen, mayHaveAlpha: false };
}

/** @param {DataView} bytes @param {readonly number[]} start */
const startsWith = (bytes, start) =>
  bytes.byteLength > FIRST_CHUNK && start.every((value, at) => bytes.getUint8(at) === value);

/** @param {DataView} bytes @param {number} at */
const nameAt = (bytes, at) => String.fromCharCode(...[0, 1, 2, 3].map((i) => bytes.getUint8(at + i)));

/** @param {Blob} whole @param {DataView} bytes @returns {StoredImage} */
function storedPng(whole, bytes) {
  let mayHaveAlpha = bytes.byteLength > COLOR_TYPE && (bytes.getUint8(COLOR_TYPE) & 4) !== 0;
  /** @type {[number, number][]} */
  const exif = [];
  for (let at = FIRST_CHUNK; at + CHUNK_FRAME <= bytes.byteLength; ) {
    const end = at + CHUNK_FRAME + bytes.getUint32(at);
    const name = nameAt(bytes, at + 4);
    if (name === "tRNS") mayHaveAlpha = true;
    if (name === "eXIf") exif.push([at, end]);
    at = end;
  }
  const file = without(whole, exif);
  return { file, seen: file, mayHaveAlpha };
}

/** From where to where there is EXIF data. @param {DataView} bytes @returns {[number, number][]} */
function jpegExif(bytes) {
  /** @type {[number, number][]} */
  const exif = [];
  for (let at = 2; at + 8 <= bytes.byteLength && bytes.getUint8(at) === 0xff; ) {
    const marker = bytes.getUint8(at + 1);
    if (marker === 0xda) break; // the pixels
    const end = at + 2 + bytes.getUint16(at + 2);
    if (marker === 0xff) at += 1;
    else {
      if (marker === 0xe1 && nameAt(bytes, at + 4) === "Exif") exif.push([at, end]);
      at = end;
    }
  }
  return exif;
}

/** @param {Blob} file @param {readonly [number, number][]} spans in their order */
function without(file, spans) {
  if (spans.length === 0) return file;
  const starts = [0, ...spans.map(([, end]) => end)];
  const ends = [...spans.map(([start]) => start), file.size];
  return new Blob(
    starts.map((start, i) => file.slice(start, ends[i])),
    { type: file.type },
  );
}

/** So many columns and rows of pixels are looked at: transparency that hides something covers areas. */
const SAMPLED = 64;

/**
 * Whether a picture hides nothing: CARLA's own PNGs have an alpha channel that is opaque. The file is decoded beside
 * the page's thread, which only sees a sample.
 * @param {Blob} file
 */
export async function isOpaque(file) {
  const size = { resizeWidth: SAMPLED, resizeHeight: SAMPLED };
  const sample = await createImageBitmap(file, { ...size, resizeQuality: "pixelated" });
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = SAMPLED;
  const ctx = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { willReadFrequently: true }));
  ctx.drawImage(sample, 0, 0);
  sample.close();
  const { data } = ctx.getImageData(0, 0, SAMPLED, SAMPLED);
  return data.every((value, i) => i % 4 !== 3 || value === 255);
}

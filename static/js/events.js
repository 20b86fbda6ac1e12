// @ts-check
// Server-sent events by fetch: an EventSource cannot show a session. Events, retries and
// `readyState` are those of an EventSource.

import { ApiError, send } from "./api.js";

/** States, as an EventSource numbers them. */
const CONNECTING = 0;
const OPEN = 1;
const CLOSED = 2;
const RETRY_MS = 1000;

/** @typedef {{event: string, data: string}} Told */

export class EventStream extends EventTarget {
  #stop = new AbortController();
  #lastId = "";
  #retryMs = RETRY_MS;
  readyState = CONNECTING;

  /** @param {string} url */
  constructor(url) {
    super();
    this.url = url;
    void this.#run();
  }

  close() {
    this.readyState = CLOSED;
    this.#stop.abort();
  }

  async #run() {
    while (this.readyState !== CLOSED) {
      const isRefused = await this.#listen();
      if (this.readyState === CLOSED) return;
      this.readyState = isRefused ? CLOSED : CONNECTING;
      this.dispatchEvent(new Event("error"));
      if (!isRefused) await new Promise((done) => setTimeout(done, this.#retryMs));
    }
  }

  /** @returns {Promise<boolean>} true: there is nothing to ask for again */
  async #listen() {
    /** @type {Record<string, string>} */
    const headers = { Accept: "text/event-stream" };
    if (this.#lastId) headers["Last-Event-ID"] = this.#lastId;
    try {
      const answer = await send(this.url, { headers, cache: "no-store", signal: this.#stop.signal });
      if (answer.status !== 200 || !answer.body) return true;
      this.readyState = OPEN;
      await this.#read(answer.body);
      return false;
    } catch (error) {
      // What breaks off in the middle is no refusal either.
      return error instanceof ApiError;
    }
  }

  /** @param {ReadableStream<Uint8Array>} body */
  async #read(body) {
    const reader = body.getReader();
    const decoder = new TextDecoder();
    let rest = "";
    /** @type {Told} */
    let told = { event: "message", data: "" };
    for (let { value, done } = await reader.read(); !done; { value, done } = await reader.read()) {
      const lines = (rest + decoder.decode(value, { stream: true })).split(/\r\n|\r|\n/);
      rest = lines.pop() ?? "";
      for (const line of lines) told = this.#hear(line, told);
    }
  }

  /** @param {string} line @param {Told} told @returns {Told} what is told so far */
  #hear(line, told) {
    if (line === "") {
      if (told.data && this.readyState !== CLOSED) this.dispatchEvent(new MessageEvent(told.event, { data: told.data.slice(0, -1) }));
      return { event: "message", data: "" };
    }
    const [, field = "", value = ""] = /^([^:]*):? ?(.*)$/.exec(line) ?? [];
    if (field === "id") this.#lastId = value;
    if (field === "retry" && /^\d+$/.test(value)) this.#retryMs = Number(value);
    if (field === "event") return { ...told, event: value };
    return field === "data" ? { ...told, data: `${told.data}${value}\n` } : told;
  }
}

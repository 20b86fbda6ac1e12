// @ts-check
// Calls that the types of core/api.js must accept, and calls that they must refuse. This file is only
// checked by tsc, never run: tsc also reports each line that is marked as an error and has none.

import { ask, get, patch, post, put, remove, url } from "../../../static/js/core/api.js";

export async function accepted() {
  const run = await get("/api/v1/runs/{run_id}", { path: { run_id: 3 }, signal: new AbortController().signal });
  /** @type {"queued" | "running" | "done" | "failed" | "cancelled"} */
  const state = run.state;
  const { items } = await get("/api/v1/boxes", { query: { dataset: "street", verdict: "kept", limit: 10 } });
  /** @type {[number, number, number, number] | null | undefined} */
  const xyxy = items[0]?.xyxy;
  const review = await post("/api/v1/boxes/{box_id}/reviews", { path: { box_id: 1 }, body: { verdict: "keep", seen_revision: 0 }, key: "once" });
  await get("/api/v1/session");
  await ask("put", "/api/v1/datasets/{dataset}/frames/{key}", { path: { dataset: "street", key: "1" }, query: { replace: true }, body: new FormData() });
  await ask("post", "/api/v1/folders", { query: { layout: "auto" }, body: new Blob([], { type: "application/x-tar" }) });
  await remove("/api/v1/datasets/{dataset}", { path: { dataset: "street" }, query: { confirm: "street" } });
  return { state, xyxy, revision: review.revision + 1, crop: url("/api/v1/boxes/{box_id}/crop", { path: { box_id: 1 } }) };
}

export async function refused() {
  // @ts-expect-error there is no such path
  await get("/api/v1/boxs", { query: { dataset: "street" } });
  // @ts-expect-error the path has no such method
  await put("/api/v1/runs/{run_id}", { path: { run_id: 3 } });
  // @ts-expect-error a part of the path is not given
  await get("/api/v1/runs/{run_id}");
  // @ts-expect-error a part of the path has another name
  await get("/api/v1/runs/{run_id}", { path: { id: 3 } });
  // @ts-expect-error a parameter that is needed is not given
  await get("/api/v1/boxes", { query: {} });
  // @ts-expect-error there is no such parameter
  await get("/api/v1/boxes", { query: { dataset: "street", verdicts: "kept" } });
  // @ts-expect-error there is no such verdict
  await get("/api/v1/boxes", { query: { dataset: "street", verdict: "keep" } });
  // @ts-expect-error there is no such answer
  await post("/api/v1/boxes/{box_id}/reviews", { path: { box_id: 1 }, body: { verdict: "kept", seen_revision: 0 } });
  // @ts-expect-error a field of the body is not given
  await post("/api/v1/boxes/{box_id}/reviews", { path: { box_id: 1 }, body: { verdict: "keep" } });
  // @ts-expect-error the body has no such field
  await patch("/api/v1/datasets/{dataset}", { path: { dataset: "street" }, body: { palet: "auto" } });
  // @ts-expect-error there is no body
  await post("/api/v1/runs/{run_id}/cancel", { path: { run_id: 3 }, body: {} });
  // @ts-expect-error a form is sent there, and nothing else
  await ask("put", "/api/v1/datasets/{dataset}/frames/{key}", { path: { dataset: "street", key: "1" }, body: { annotation: {} } });
  // @ts-expect-error an address has no body
  url("/api/v1/boxes/{box_id}/crop", { path: { box_id: 1 }, body: {} });
  const run = await get("/api/v1/runs/{run_id}", { path: { run_id: 3 } });
  // @ts-expect-error the answer has no such field
  return run.progress;
}

import type { operations, components } from "./api";
import { readFileSync } from "node:fs";

declare const process: { argv: string[] };
const [url, token, name, segmentation] = process.argv.slice(2) as string[];
const headers = { Authorization: `Bearer ${token}` };
type Schemas = components["schemas"];

const dataset: Schemas["DatasetIn"] = { name: name!, config: { profile: "paper", evidence: "semantic" } };
const annotation: Schemas["Annotation"] = { boxes: [{ class: "car", xyxy: [1, 1, 5, 5], id: "217" }] };

async function main() {
  const json = { ...headers, "Content-Type": "application/json" };
  await fetch(`${url}/api/v1/datasets`, { method: "POST", headers: json, body: JSON.stringify(dataset) });
  const form = new FormData();
  form.append("annotation", new Blob([JSON.stringify(annotation)], { type: "application/json" }));
  form.append("segmentation", new Blob([readFileSync(segmentation!)], { type: "image/png" }), "seg.png");
  const answer = await fetch(`${url}/api/v1/datasets/${name}/frames/town/1`, { method: "PUT", headers, body: form });
  type Stored = operations["put_frame"]["responses"][201]["content"]["application/json"];
  const stored = (await answer.json()) as Stored;
  console.log(stored.decisions[0]?.id);
}

main();

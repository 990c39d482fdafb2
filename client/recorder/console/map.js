// One map: in 3-D, what it knows of itself, and what can be done with it.

import { call, download, get, objectUrl, path, request } from "../shared/api.js";
import { ask, fill, h } from "../shared/dom.js";
import { bytes, count, length, when } from "./format.js";
import { action, facts, field, loading, nameField, page, skeletons, tell } from "./parts.js";
import { SceneView, readScene } from "./scene.js";

const FORMATS = [
  ["rho", "the map itself (.rho)", "rho"],
  ["csv", "densities, Table 5 (.csv)", "csv"],
  ["observations", "observations, Table 4 (.csv)", "csv"],
  ["trajectory", "walk, Table 6 (.csv)", "csv"],
  ["ply", "landmarks (.ply)", "ply"],
  ["vtp", "landmarks (.vtp)", "vtp"],
];

export async function showMap(main, name, signal) {
  const scene = new SceneView(`Landmarks and walk of the map ${name}`);
  signal.addEventListener("abort", () => scene.dispose());
  const about = h("div", { class: "stack" }, skeletons(1, "panel"));
  const picture = h(
    "div",
    { class: "report-picture", tabindex: 0, role: "group", "aria-label": "Coverage" },
    skeletons(1, "fill"),
  );
  fill(
    main,
    page(
      name,
      actions(name),
      h("div", { class: "map-columns" }, scene.element, about),
      h("h2", {}, "Where it works"),
      picture,
    ),
  );
  const address = path`v1/maps/${name}`;
  const map = await get(address, { signal }); // a map that is gone is told instead of the page
  await Promise.all([
    loading(about, async () => fillAbout(about, map, await get(`${address}/report`, { signal })), signal),
    showScene(scene, map, signal),
    loading(picture, () => fillPicture(picture, address, name, signal), signal),
  ]);
}

/** Fetch a map's scene and show it. */
export async function showScene(view, map, signal) {
  const response = await request(path`v1/maps/${map.name}/scene`, { signal });
  view.showMap(readScene(await response.arrayBuffer()), map.waypoints, map.scale === "metric");
}

async function fillPicture(place, address, name, signal) {
  const picture = h("img", {
    alt: `Coverage of ${name} by position and heading, and its held-out errors`,
    src: await objectUrl(`${address}/report.png`, { signal }),
  });
  signal.addEventListener("abort", () => URL.revokeObjectURL(picture.src));
  fill(place, picture);
}

function fillAbout(place, map, { report }) {
  const metric = map.scale === "metric";
  const heldOut = report.held_out;
  const advice = [report.coaching ?? []]
    .flat()
    .flatMap((section) => section.advice ?? [])
    .map(({ text }) => text);
  fill(
    place,
    !metric &&
      h("p", { class: "notice warn" }, "Nothing measured fixed this map's unit of length: positions are not metres."),
    h(
      "section",
      { class: "card stack" },
      h("h2", {}, "What it is"),
      facts([
        ["Landmarks", count(map.landmarks)],
        ["Views", count(map.views)],
        ["Features", `${map.features}, ${map.density} densities`],
        ["File", bytes(map.size_bytes)],
        ["Made", when(map.created)],
        ["Version", `${map.version}, of map ${map.id.slice(0, 8)}`],
        ["Camera", `${map.camera.width} × ${map.camera.height}, f ${map.camera.fx.toFixed(0)} px`],
      ]),
    ),
    h(
      "section",
      { class: "card stack" },
      h("h2", {}, "How good it is"),
      heldOut?.frames
        ? facts([
            ["Held out", `${heldOut.localized} of ${heldOut.frames} frames localized`],
            ["Median error", measured(heldOut.median_m, (value) => length(value, metric))],
            ["Median turn", measured(heldOut.median_deg, (value) => `${value.toFixed(2)}°`)],
            ["90 % within", measured(heldOut.p90_m, (value) => length(value, metric))],
          ])
        : h("p", { class: "muted" }, "No frames were held out of it."),
      facts([["Landmark uncertainty", measured(report.landmark_sigma_median_m, (value) => length(value, metric))]]),
      advice.length > 0 && [
        h("h3", {}, "On the next walk"),
        h(
          "ul",
          {},
          advice.map((text) => h("li", {}, text)),
        ),
      ],
    ),
    h("section", { class: "card stack" }, h("h2", {}, "Learned from"), sources(map)),
    map.waypoints.length > 0 && h("section", { class: "card stack" }, h("h2", {}, "Waypoints"), waypoints(map, metric)),
    h("section", { class: "card stack" }, h("h2", {}, "Take it away"), downloads(map.name)),
  );
}

/** A report may lack a figure, or hold none. */
const measured = (value, show) => (Number.isFinite(value) ? show(value) : null);

function sources({ name, sources: all }) {
  return h(
    "ul",
    { class: "plain" },
    all.map((source) =>
      h(
        "li",
        { class: "row spread" },
        h(
          "span",
          {},
          String(source.name ?? source.id),
          " ",
          h(
            "span",
            { class: "muted small" },
            `${source.frames ?? "?"} frames${source.poses ? `, poses ${source.poses}` : ""}`,
          ),
        ),
        all.length > 1 && action("Forget", () => forget(name, source), "danger"),
      ),
    ),
  );
}

function waypoints(map, metric) {
  return h(
    "div",
    { class: "scroll", tabindex: 0, role: "group", "aria-label": "Waypoints" },
    h(
      "table",
      {},
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          ["Name", "x, y, z", "Off by"].map((text) => h("th", { scope: "col" }, text)),
        ),
      ),
      h(
        "tbody",
        {},
        map.waypoints.map(({ name, position, residual_m: residual }) =>
          h(
            "tr",
            {},
            h("td", {}, name),
            h("td", { class: "mono" }, position.map((v) => v.toFixed(2)).join(", ")),
            h("td", {}, residual === null ? "–" : length(residual, metric)),
          ),
        ),
      ),
    ),
  );
}

function downloads(name) {
  const format = h(
    "select",
    { "aria-label": "Format" },
    FORMATS.map(([value, text]) => h("option", { value }, text)),
  );
  return h(
    "div",
    { class: "row" },
    format,
    action("Download", () => {
      const [value, , suffix] = FORMATS.find(([one]) => one === format.value);
      const saved = suffix === "csv" && value !== "csv" ? `${name}-${value}.csv` : `${name}.${suffix}`;
      return download(path`v1/maps/${name}/download`, saved, { query: { format: value } });
    }),
  );
}

function actions(name) {
  return h(
    "div",
    { class: "row" },
    h("a", { class: "button primary", href: `#/try/${encodeURIComponent(name)}` }, "Try it"),
    action("Update", () => update(name)),
    action("Merge", () => merge(name)),
    action("Rename", () => rename(name)),
    action("Delete", () => remove(name), "danger"),
  );
}

const go = (name) => (location.hash = `#/maps/${encodeURIComponent(name)}`);

async function rename(name) {
  const input = nameField(name);
  const done = await ask("Rename the map", field("Name", input), h("button", { class: "primary" }, "Rename"), () =>
    call("PATCH", path`v1/maps/${name}`, { body: { name: input.value } }),
  );
  if (done) go(input.value);
}

async function remove(name) {
  const done = await ask(
    "Delete the map?",
    h("p", {}, "The map ", h("strong", {}, name), " is deleted for good. Recordings are kept."),
    h("button", { class: "danger primary" }, "Delete"),
    () => call("DELETE", path`v1/maps/${name}`),
  );
  if (done) location.hash = "#/maps";
}

async function merge(name) {
  const others = (await get("v1/maps")).maps.filter((map) => map.name !== name);
  if (!others.length) {
    tell("There is no other map to merge with.", "warn");
    return;
  }
  const other = h(
    "select",
    { name: "other" },
    others.map((map) => h("option", {}, map.name)),
  );
  const into = nameField(`${name}-merged`);
  const done = await ask(
    "Merge with another map",
    [
      h("p", { class: "muted" }, "The other map comes into this one's frame. They must overlap."),
      field("Other map", other),
      field("Name of the merged map", into),
    ],
    h("button", { class: "primary" }, "Merge"),
    () => call("POST", path`v1/maps/${name}/merge`, { body: { other: other.value, into: into.value } }),
  );
  if (done) go(into.value);
}

async function update(name) {
  const { recordings } = await get("v1/recordings");
  if (!recordings.length) {
    tell("There is no recording yet. Upload one, and choose to update this map.", "warn");
    location.hash = "#/recordings";
    return;
  }
  const chosen = h(
    "select",
    { name: "recording" },
    recordings.map((one) =>
      h(
        "option",
        { value: one.id },
        `${one.files[0]}${one.files.length > 1 ? ` and ${one.files.length - 1} more` : ""}, ${when(one.created)}`,
      ),
    ),
  );
  let job;
  const done = await ask(
    "Learn a further recording",
    field("Recording", chosen),
    h("button", { class: "primary" }, "Update"),
    async () => {
      job = await call("POST", path`v1/maps/${name}/update`, { body: { recording: chosen.value } });
    },
  );
  if (done) location.hash = `#/jobs/${job.id}`;
}

async function forget(name, source) {
  const done = await ask(
    "Forget a recording?",
    h("p", {}, "What the map learned from ", h("strong", {}, String(source.name)), " is taken out of it."),
    h("button", { class: "danger primary" }, "Forget"),
    () => call("POST", path`v1/maps/${name}/forget`, { body: { source: source.id ?? source.name } }),
  );
  if (done) dispatchEvent(new HashChangeEvent("hashchange"));
}

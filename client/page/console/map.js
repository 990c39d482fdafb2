// One map: whether it can be relied on, where it works, in 3-D, what it knows of itself, and what can be done with it.

import { download, objectUrl, path, rholoc } from "../shared/api.js";
import { action, ask, fill, h, tell } from "../shared/dom.js";
import { field, mapNameOf, nameChoice, nameField } from "../shared/name_choice.js";
import { coordinates, decimal, heard, t } from "../shared/text.js";
import { inPlainWords, mistakesIn, mostTrusted, restsOnGivenPoses, Trust, trustOf, whatToDo } from "../shared/trust.js";
import { coverageView } from "./coverage_view.js";
import { keptPlan } from "./floor_plan.js";
import { bytes, count, fileNames, length, when } from "./format.js";
import { learningText } from "./learning.js";
import { liveView } from "./live.js";
import { expectedError, placeOf } from "./maps.js";
import { facts, loading, page, skeletons } from "./parts.js";
import { rightness } from "./rightness.js";
import { SceneView } from "./scene.js";
import { readPoints, readRoom, readScene } from "./scene_data.js";
import { share } from "./share.js";

const FORMATS = [
  ["rho", t`the map itself (.rho)`, "rho"],
  ["csv", t`densities (.csv)`, "csv"],
  ["observations", t`observations (.csv)`, "csv"],
  ["trajectory", t`walk (.csv)`, "csv"],
  ["ply", t`landmarks (.ply)`, "ply"],
  ["vtp", t`landmarks (.vtp)`, "vtp"],
  ["gltf", t`landmarks in colour, for Blender and the web (.glb)`, "glb"],
  ["colmap", t`cameras and points for COLMAP and Gaussian splatting (.zip)`, "zip"],
  ["nerfstudio", t`cameras for nerfstudio (.json)`, "json"],
];

export async function showMap(main, name, signal) {
  const scene = new SceneView(t`Landmarks and walk of the map ${name}`);
  signal.addEventListener("abort", () => scene.dispose());
  const trust = h("div", { class: "trust" }, skeletons(1, "notice-line"));
  const about = h("div", { class: "stack" }, skeletons(1, "panel"));
  const watching = h("div", { class: "row" });
  const live = h("div", {});
  const works = h("div", {}, skeletons(1, "coverage"));
  fill(
    main,
    page(
      name,
      actions(name),
      trust,
      h(
        "div",
        { class: "map-columns" },
        h(
          "div",
          { class: "stack" },
          h("div", { class: "row spread" }, h("h2", {}, t`The room`), watching),
          scene.element,
          live,
          h("h2", {}, t`Where it works`),
          works,
        ),
        about,
      ),
    ),
  );
  const address = path`v1/maps/${name}`;
  const map = await rholoc.get(address, { signal }); // of a map that is gone the page says so, and nothing else
  if (map.keeps_refused) {
    const where = `#/maps/${encodeURIComponent(name)}/refusals`;
    watching.append(h("a", { class: "button", href: where }, t`Refused`));
  }
  if (map.live) {
    const watcher = liveView(map, scene, signal);
    watching.append(watcher.button);
    fill(live, watcher.element);
  }
  const report = rholoc.get(`${address}/report`, { signal }).then(({ report }) => report);
  const learning = rholoc.get(`${address}/learning`, { signal });
  await Promise.all([
    loading(trust, async () => fill(trust, trustNotice(map, await report)), signal),
    loading(about, async () => fillAbout(about, map, ...(await Promise.all([report, learning]))), signal),
    loading(works, async () => fill(works, await showCoverage(map, await report, scene, signal)), signal),
    showScene(scene, map, signal).then(async () => {
      const { expected_error: expected } = await report;
      if (trustOf(map) === Trust.YES && expected) scene.offerErrors(expected.views_m);
      if (trustOf(map) === Trust.NO && scene.scene.second) scene.showTwice(true);
    }),
  ]);
}

/** Fetch a map's scene and show it. */
export async function showScene(view, map, signal) {
  const fetched = (where) => rholoc.bytes(path`v1/maps/${map.name}/${where}`, { signal });
  if (map.pictures)
    view.pictureOf = (number) => objectUrl(path`v1/maps/${map.name}/views/${number}/picture.jpg`, { signal });
  view.offerCloud(map.points, async () => readPoints(await fetched("points")));
  view.featureOf = (number) => rholoc.get(path`v1/maps/${map.name}/features/${number}`, { signal });
  view.showMap(readScene(await fetched("scene")), map.waypoints, map.scale === "metric", map.names, map.levelling);
  if (map.room) view.showRoom(readRoom(await fetched("room")));
  if (map.plan) view.showPlan(await keptPlan(map, signal));
}

/** What the report has of it; older maps have it worked out by the server. */
async function showCoverage(map, report, scene, signal) {
  const coverage = report.coverage?.counts
    ? report.coverage
    : await rholoc.get(path`v1/maps/${map.name}/coverage`, { signal });
  const failed = map.keeps_failures ? (await rholoc.get(path`v1/maps/${map.name}/failures`, { signal })).failures : [];
  const errors = trustOf(map) === Trust.YES ? (report.expected_error?.views_m ?? []) : [];
  const near = (place, degrees) => scene.scene && rightness(scene.scene.views, errors, place, degrees);
  const look = (T, place, degrees) => {
    scene.showPose(T);
    const found = near(place, degrees);
    if (found) scene.showView(found.view);
  };
  return coverageView(coverage, map, signal, look, (...spot) => near(...spot)?.error ?? null, failed);
}

/** Whether the map can be relied on, why, and what to do next. */
function trustNotice(map, report) {
  const trust = trustOf(map);
  const [kind, title] = {
    [Trust.YES]: ["good", t`This map passed its checks.`],
    [Trust.NO]: ["bad", t`Do not rely on this map.`],
    [Trust.UNKNOWN]: ["warn", t`Nothing has checked this map.`],
  }[trust];
  const reason = inPlainWords(map.trust_reason);
  const given = restsOnGivenPoses(map);
  const mistakes = mistakesIn(report);
  const next = whatToDo(trust, mistakes, map.trust_reason);
  return h(
    "section",
    { class: ["notice stack", !given && kind], "aria-label": t`Trust` },
    h(
      "p",
      {},
      h("strong", {}, given ? t`Its poses came with the recording.` : title),
      " ",
      given ? t`Nothing else has checked this map: it is as right as they are.` : reason?.plain,
    ),
    mistakes.map((mistake) => h("p", {}, h("strong", {}, mistake))),
    next && h("p", {}, h("strong", {}, t`What to do:`), " ", next),
    reason?.technical &&
      h("details", {}, h("summary", { class: "small" }, t`In figures`), h("p", { class: "small" }, reason.technical)),
  );
}

function fillAbout(place, map, report, learning) {
  const learned = learningText(learning);
  const metric = map.scale === "metric";
  const advice = [report.coaching ?? []]
    .flat()
    .flatMap((section) => section.advice ?? [])
    .map(({ text }) => heard(text));
  fill(
    place,
    !metric &&
      h("p", { class: "notice warn" }, t`No measurement fixed this map's unit of length: positions are not metres.`),
    errorsCard(map, report, metric),
    advice.length > 0 &&
      h(
        "section",
        { class: "card stack" },
        h("h2", {}, t`On the next walk`),
        h(
          "ul",
          {},
          advice.map((text) => h("li", {}, text)),
        ),
      ),
    h(
      "section",
      { class: "card stack" },
      h("h2", {}, t`Details`),
      facts([
        [t`Place`, placeOf(map)],
        [t`Tags`, map.labels.tags.join(", ") || null],
        [t`Landmarks`, count(map.landmarks)],
        [t`Views`, count(map.views)],
        [t`File`, bytes(map.size_bytes)],
        [t`Made`, when(map.created)],
        [t`Version`, map.version],
      ]),
      h(
        "details",
        {},
        h("summary", { class: "small" }, t`For developers`),
        facts([
          ["ID", h("code", {}, map.id)],
          [t`Features`, map.features],
          [t`Densities`, map.density],
          [t`Camera`, `${map.camera.width} × ${map.camera.height}, f ${decimal(map.camera.fx)} px`],
        ]),
      ),
      h(
        "div",
        { class: "row" },
        action(t`Site, floor, tags`, () => label(map)),
      ),
      map.previous && previous(map),
    ),
    h(
      "section",
      { class: "card stack" },
      h("h2", {}, t`Learned from`),
      sources(map),
      learned && h("p", { class: "small muted" }, learned),
    ),
    map.waypoints.length > 0 &&
      h("section", { class: "card stack" }, h("h2", {}, t`Waypoints`), waypoints(map, metric)),
    h("section", { class: "card stack" }, h("h2", {}, t`Export`), downloads(map.name)),
  );
}

/** How wrong it is, and against what: its own walk, which does not see an error of the walk as a whole, or a tape measure. */
function errorsCard(map, report, metric) {
  const heldOut = report.held_out;
  const residuals = map.waypoints.map(({ residual_m: residual }) => residual).filter(Number.isFinite);
  const inLength = (value) => length(value, metric);
  return h(
    "section",
    { class: "card stack" },
    h("h2", {}, t`How good it is`),
    facts([[t`Expected error`, expectedError(map)]]),
    h("h3", {}, t`How well it agrees with itself`),
    heldOut?.frames
      ? [
          facts([
            [t`Held out`, t`${heldOut.localized} of ${heldOut.frames} frames localized`],
            [t`Median`, measured(heldOut.median_m, inLength)],
            [t`Median turn`, measured(heldOut.median_deg, (value) => `${decimal(value, 2)}°`)],
            [t`90 % within`, measured(heldOut.p90_m, inLength)],
          ]),
          h(
            "p",
            { class: "small muted" },
            t`Frames of the walk that the map was not made from. If the walk as a whole is bent, they do not show it.`,
          ),
        ]
      : h("p", { class: "muted" }, t`No frames were held out of it.`),
    h("h3", {}, t`Against measured points`),
    residuals.length
      ? facts([
          [t`Points`, residuals.length],
          [t`Worst`, inLength(Math.max(...residuals))],
        ])
      : h("p", { class: "muted" }, t`No measured point checks it.`),
  );
}

/** The map that this one replaced. */
function previous({ name, previous: before }) {
  return h(
    "div",
    { class: "row spread" },
    h("span", { class: "small" }, t`Replaced the map of ${when(before.created)}, version ${before.version}`),
    action(t`Restore it`, async () => {
      const done = await ask(
        t`Restore the previous map?`,
        h(
          "p",
          {},
          t`It comes back under this name. The present one is kept in its place, and can be restored in turn.`,
        ),
        h("button", { class: "primary" }, t`Restore`),
        () => rholoc.call("POST", path`v1/maps/${name}/restore`),
      );
      if (done) dispatchEvent(new HashChangeEvent("hashchange"));
    }),
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
            [t`${source.frames ?? "?"} frames`, source.poses && t`poses ${source.poses}`].filter(Boolean).join(", "),
          ),
        ),
        all.length > 1 && action(t`Forget`, () => forget(name, source), "danger"),
      ),
    ),
  );
}

function waypoints(map, metric) {
  return h(
    "div",
    { class: "scroll", tabindex: 0, role: "group", "aria-label": t`Waypoints` },
    h(
      "table",
      {},
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          [t`Name`, "x, y, z", t`Off by`].map((text) => h("th", { scope: "col" }, text)),
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
            h("td", { class: "mono" }, coordinates(position)),
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
    { "aria-label": t`Format` },
    FORMATS.map(([value, text]) => h("option", { value }, text)),
  );
  return h(
    "div",
    { class: "row" },
    format,
    action(t`Download`, () => {
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
    h("a", { class: "button primary", href: `#/try/${encodeURIComponent(name)}` }, t`Try it`),
    h("a", { class: "button", href: `#/maps/${encodeURIComponent(name)}/correct` }, t`Make it right`),
    action(t`Share`, () => share(name)),
    h(
      "details",
      { class: "menu" },
      h("summary", { class: "button" }, t`More`),
      h(
        "div",
        { class: "card stack" },
        action(t`Update`, () => update(name)),
        action(t`Merge`, () => merge(name)),
        action(t`Rename`, () => rename(name)),
        h("hr", {}),
        action(t`Delete`, () => remove(name), "danger"),
      ),
    ),
  );
}

/** A map's name, and a word of warning where it has earned one. */
export const trusted = (map) => (trustOf(map) === Trust.NO ? t`${map.name} (not trusted)` : map.name);

const go = (name) => (location.hash = `#/maps/${encodeURIComponent(name)}`);

async function rename(name) {
  const input = nameField(name);
  const done = await ask(t`Rename the map`, field(t`Name`, input), h("button", { class: "primary" }, t`Rename`), () =>
    rholoc.call("PATCH", path`v1/maps/${name}`, { body: { name: mapNameOf(input.value) } }),
  );
  if (done) go(mapNameOf(input.value));
}

async function remove(name) {
  const done = await ask(
    t`Delete the map?`,
    h("p", {}, t`The map ${name} is deleted for good. Recordings are kept.`),
    h("button", { class: "danger primary" }, t`Delete`),
    () => rholoc.call("DELETE", path`v1/maps/${name}`),
  );
  if (done) location.hash = "#/maps";
}

/** Say what a map belongs to. */
async function label({ name, labels }) {
  const input = (value) => h("input", { value, maxlength: 100, autocomplete: "off" });
  const [site, floor, tags] = [input(labels.site), input(labels.floor), input(labels.tags.join(", "))];
  tags.removeAttribute("maxlength");
  const done = await ask(
    t`Site, floor, tags`,
    [
      h("p", { class: "muted" }, t`The list of maps is searched and grouped by them.`),
      field(t`Site`, site),
      field(t`Floor`, floor),
      field(t`Tags`, tags, t`Words with commas between`),
    ],
    h("button", { class: "primary" }, t`Save`),
    () => {
      const words = tags.value.split(",").map((tag) => tag.trim());
      const body = { kind: "labels", site: site.value, floor: floor.value, tags: words.filter(Boolean) };
      return rholoc.call("POST", path`v1/maps/${name}/corrections`, { body });
    },
  );
  if (done) dispatchEvent(new HashChangeEvent("hashchange"));
}

async function merge(name) {
  const others = (await rholoc.get("v1/maps")).maps.filter((map) => map.name !== name);
  if (!others.length) {
    tell(t`There is no other map to merge with.`, "warn");
    return;
  }
  const other = h(
    "select",
    { name: "other" },
    others.map((map) => h("option", { value: map.name, selected: map === mostTrusted(others) }, trusted(map))),
  );
  const into = nameChoice({ names: [name, ...others.map((map) => map.name)], learns: false });
  into.suggest(`${name}-merged`);
  const done = await ask(
    t`Merge with another map`,
    [
      h("p", { class: "muted" }, t`The other map comes into this one's frame. They must overlap.`),
      field(t`Other map`, other),
      into.element,
    ],
    h("button", { class: "primary" }, t`Merge`),
    () => rholoc.call("POST", path`v1/maps/${name}/merge`, { body: { other: other.value, into: into.value } }),
  );
  if (done) go(into.value);
}

async function update(name) {
  const { recordings } = await rholoc.get("v1/recordings");
  if (!recordings.length) {
    tell(t`There is no recording yet. Upload one, and choose to update this map.`, "warn");
    location.hash = "#/recordings";
    return;
  }
  const chosen = h(
    "select",
    { name: "recording" },
    recordings.map((one) => h("option", { value: one.id }, `${fileNames(one)}, ${when(one.created)}`)),
  );
  let job = /** @type {any} */ (null);
  const done = await ask(
    t`Learn a further recording`,
    field(t`Recording`, chosen),
    h("button", { class: "primary" }, t`Update`),
    async () => {
      job = await rholoc.call("POST", path`v1/maps/${name}/update`, { body: { recording: chosen.value } });
    },
  );
  if (done) location.hash = `#/jobs/${job.id}`;
}

async function forget(name, source) {
  const done = await ask(
    t`Forget a recording?`,
    h("p", {}, t`What the map learned from ${source.name} is taken out of it.`),
    h("button", { class: "danger primary" }, t`Forget`),
    () => rholoc.call("POST", path`v1/maps/${name}/forget`, { body: { source: source.id ?? source.name } }),
  );
  if (done) dispatchEvent(new HashChangeEvent("hashchange"));
}

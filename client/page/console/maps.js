// The maps that are served.

import { path, rholoc } from "../shared/api.js";
import { action, ask, fill, h, tell } from "../shared/dom.js";
import { field, nameChoice } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { inPlainWords, Trust, trustOf, whatToDo } from "../shared/trust.js";
import { bytes, count, length, when } from "./format.js";
import { listTools } from "./list_tools.js";
import { empty, facts, loading, page, skeletons, trustBadge } from "./parts.js";
import { drawRoom, surfaces } from "./room.js";
import { readRoom, readScene } from "./scene_data.js";
import { drawFromAbove } from "./thumbnail.js";

const LANDMARKS_DRAWN = 1500; // on a card
const ORDERS = [
  ["name", t`by name`, (a, b) => a.name.localeCompare(b.name)],
  ["created", t`the newest first`, (a, b) => b.created.localeCompare(a.created)],
  ["trust", t`those in doubt first`, (a, b) => Number(a.trusted ?? 0.5) - Number(b.trusted ?? 0.5)],
  ["size", t`the largest first`, (a, b) => b.size_bytes - a.size_bytes],
];
/** @type {[string, string, (map: any) => string[]][]} */
const GROUPS = [
  ["site", t`by site`, ({ labels }) => [labels.site]],
  ["floor", t`by floor`, ({ labels }) => [[labels.site, labels.floor].filter(Boolean).join(", ")]],
  ["tag", t`by tag`, ({ labels }) => labels.tags],
];

export async function showMaps(main, _, signal) {
  const list = h("ul", { class: "cards", "aria-label": t`Maps` }, skeletons(3, "map-card"));
  let found = { maps: [], unreadable: {} };
  const tools = listTools({
    orders: ORDERS,
    groups: GROUPS,
    textOf: ({ name, labels }) => [name, labels.site, labels.floor, ...labels.tags].join(" "),
    changed: () => fillList(list, found, tools, signal),
  });
  const reload = () =>
    loading(
      list,
      async () => {
        found = await rholoc.get("v1/maps", { signal });
        fillList(list, found, tools, signal);
      },
      signal,
    );
  const upload = action(t`Upload a map`, () => uploadMap(found.maps, reload));
  const record = h("a", { class: "button primary", href: "record" }, t`Record a walk`);
  fill(main, page(t`Maps`, h("div", { class: "row" }, upload, record), tools.element, list));
  await reload();
}

function fillList(list, { maps, unreadable }, tools, signal) {
  const broken = Object.entries(unreadable).map(([name, why]) =>
    h("li", { class: "notice bad" }, h("strong", {}, name), ": ", why),
  );
  if (!maps.length && !broken.length) {
    fill(
      list,
      h(
        "li",
        { class: "whole-row" },
        empty(
          t`No maps yet`,
          t`One walk through a room with a phone makes a map.`,
          h("a", { class: "button primary", href: "record" }, t`Record a walk`),
          h("a", { class: "button", href: "#/recordings" }, t`Upload a recording`),
        ),
      ),
    );
    return;
  }
  const shown = tools.chosen(maps);
  fill(
    list,
    shown.map(({ title, items }) => [
      title !== null && h("li", { class: "whole-row" }, h("h2", {}, title)),
      items.map((map) => card(map, signal)),
    ]),
    broken,
    !shown.some(({ items }) => items.length) &&
      maps.length > 0 &&
      h("li", { class: "whole-row muted" }, t`No map matches.`),
  );
}

function card(map, signal) {
  const trust = trustOf(map);
  const picture = h("canvas", { class: "from-above", role: "img", "aria-label": t`${map.name} from above` });
  whenSeen(picture, signal, () => showFromAbove(picture, map, signal));
  return h(
    "li",
    { class: "card map-card" },
    h("div", { class: "picture" }, picture),
    h("h2", {}, h("a", { href: `#/maps/${encodeURIComponent(map.name)}` }, map.name)),
    h(
      "div",
      { class: "row" },
      trustBadge(map),
      map.scale === "arbitrary" && h("span", { class: "badge warn" }, t`no unit of length`),
      !map.upright && h("span", { class: "badge warn" }, t`not upright`),
      map.labels.tags.map((tag) => h("span", { class: "badge" }, tag)),
    ),
    trust === Trust.NO && h("p", { class: "small reason" }, inPlainWords(map.trust_reason)?.plain),
    trust === Trust.NO && h("p", { class: "small" }, whatToDo(trust, [], map.trust_reason)),
    facts([
      [t`Place`, placeOf(map)],
      [t`Expected error`, expectedError(map)],
      [t`Size`, t`${count(map.landmarks)} landmarks, ${bytes(map.size_bytes)}`],
      [t`Made`, when(map.created)],
      [t`Version`, map.version],
    ]),
  );
}

/** How wrong a map is expected to be, in words: of one that is not trusted nobody knows. */
export const expectedError = (map) =>
  map.expected_error_m === null || trustOf(map) === Trust.NO ? t`unknown` : length(map.expected_error_m);

/** Site and floor, or null where they are not said. */
export const placeOf = ({ labels }) => [labels.site, labels.floor].filter(Boolean).join(", ") || null;

async function showFromAbove(picture, map, signal) {
  const query = { landmarks: LANDMARKS_DRAWN, level: true };
  try {
    if (map.room) {
      const room = await rholoc.bytes(path`v1/maps/${map.name}/room`, { signal, query: { level: true } });
      const [width, height] = [picture.clientWidth, picture.clientHeight].map((size) => 2 * size);
      drawRoom(picture, surfaces(readRoom(room)), width, height);
      return;
    }
    const scene = readScene(await rholoc.bytes(path`v1/maps/${map.name}/scene`, { signal, query }));
    const draw = () => drawFromAbove(picture, scene);
    const scheme = matchMedia("(prefers-color-scheme: dark)");
    scheme.addEventListener("change", draw, { signal });
    draw();
  } catch {
    picture.classList.add("missing");
  }
}

/** Do something once an element comes near the window. */
function whenSeen(element, signal, work) {
  const observer = new IntersectionObserver(
    (entries) => {
      if (!entries.some((entry) => entry.isIntersecting)) return;
      observer.disconnect();
      work();
    },
    { rootMargin: "50%" },
  );
  observer.observe(element);
  signal.addEventListener("abort", () => observer.disconnect());
}

async function uploadMap(maps, reload) {
  const file = h("input", { type: "file", name: "file", accept: ".rho,.csv", required: true });
  const name = nameChoice({ names: maps.map((map) => map.name), learns: false });
  file.addEventListener("change", () => name.suggest(file.files[0]?.name.replace(/\.(rho|csv)$/, "") ?? ""));
  const done = await ask(
    t`Upload a map`,
    [field(t`File (.rho or .csv)`, file), name.element],
    h("button", { class: "primary" }, t`Upload`),
    () =>
      rholoc.call("PUT", path`v1/maps/${name.value}`, {
        body: file.files[0],
        headers: { "Content-Type": "application/octet-stream" },
      }),
  );
  if (done) {
    tell(t`The map is uploaded.`);
    await reload();
  }
}

// Sites: rooms and floors as one plan, placed by their links, with those that have no place yet beside it.

import { carried, rotationOf } from "../../js/poses.js";
import { path, rholoc } from "../shared/api.js";
import { action, ask, fill, h, tell } from "../shared/dom.js";
import { Purpose } from "../shared/handover.js";
import { field, mapNameOf, nameField } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { Trust, trustOf } from "../shared/trust.js";
import { drawFloor, endsOf, placedPlan } from "./floor.js";
import { expectedError } from "./maps.js";
import { Motions } from "./motions.js";
import { empty, loading, page, problem, skeletons, trustBadge } from "./parts.js";
import { readRoom, readScene, STRIDE_VIEW } from "./scene_data.js";
import { shareLink } from "./share.js";

const TINTS = { [Trust.YES]: "--accent", [Trust.NO]: "--bad", [Trust.UNKNOWN]: "--warn" };
const STALE_S = 3;
const GONE_S = 30;
const DRAWN_MS = 100;

export async function showSites(main, _, signal) {
  const list = h("ul", { class: "cards", "aria-label": t`Sites` }, skeletons(2, "camera-card"));
  fill(
    main,
    page(
      t`Sites`,
      action(t`New site`, () => editSite(null), "primary"),
      h("p", { class: "muted" }, t`Maps of rooms and floors in one frame: one plan, one pose for a whole building.`),
      list,
    ),
  );
  await loading(list, async () => fillSites(list, await rholoc.get("v1/sites", { signal })), signal);
}

function fillSites(list, { sites, unreadable }) {
  const broken = Object.entries(unreadable).map(([name, why]) =>
    h("li", { class: "notice bad" }, h("strong", {}, name), ": ", why),
  );
  const none = h("li", { class: "whole-row" }, empty(t`No sites yet`, t`A site is made of two maps or more.`));
  fill(list, sites.length || broken.length ? [sites.map(siteCard), broken] : none);
}

function siteCard({ name, maps }) {
  const floors = new Set(maps.map(({ floor }) => floor));
  const left = maps.filter(({ pose }) => !pose).length;
  return h(
    "li",
    { class: "card stack" },
    h("h2", {}, h("a", { href: `#/sites/${encodeURIComponent(name)}` }, name)),
    h("p", { class: "muted" }, t`${maps.length} maps on ${floors.size} floors`),
    left > 0 && h("p", {}, h("span", { class: "badge warn" }, t`${left} without a place`)),
  );
}

export async function showSite(main, name, signal) {
  const [site, { maps }] = await Promise.all([
    rholoc.get(path`v1/sites/${name}`, { signal }),
    rholoc.get("v1/maps", { signal }),
  ]);
  const known = new Map(maps.map((map) => [map.name, map]));
  const placed = site.maps.filter(({ pose, present }) => pose && present);
  const left = site.maps.filter(({ pose, present }) => !pose && present);
  const details = await Promise.all(placed.map(({ map }) => rholoc.get(path`v1/maps/${map}`, { signal })));
  for (const map of details) known.set(map.name, map);
  const floors = [...new Set(placed.map(({ floor }) => floor))].sort();
  const live = h("button", { type: "button", "aria-pressed": "false" }, t`Live`);
  const visible = floors.map((floor) => new Floor(floor, placed, known));
  live.addEventListener("click", () => {
    const on = live.ariaPressed !== "true";
    live.ariaPressed = String(on);
    for (const floor of visible) on ? floor.watch(signal) : floor.unwatch();
  });
  fill(
    main,
    page(
      name,
      h(
        "div",
        { class: "row" },
        action(t`Link for visitors`, () => shareVisits(name), "primary"),
        details.some((map) => map.live) && live,
        action(t`Choose maps`, () => editSite(site, maps)),
        action(t`Delete`, () => removeSite(name), "danger"),
      ),
      left.length > 0 && tray(name, left, known),
      visible.map((floor) => floor.element),
      !placed.length &&
        empty(t`Nothing has a place yet`, t`Rooms get their place by links: "Place them" looks for overlaps.`),
    ),
  );
  await Promise.all(visible.map((floor) => floor.load(signal).catch((error) => floor.fail(error, signal))));
}

/** Rooms that have no place yet. */
function tray(name, left, known) {
  return h(
    "section",
    { class: "notice warn stack" },
    h("h2", {}, t`Without a place`),
    h(
      "div",
      { class: "row" },
      left.map(({ map }) => roomLink(known.get(map), map)),
    ),
    h("p", {}, t`Where rooms overlap, their place is found from pictures of one that are recognised in another.`),
    h(
      "div",
      { class: "row" },
      action(t`Place them`, async () => {
        const { id } = await rholoc.call("POST", path`v1/sites/${name}/place`);
        location.hash = `#/jobs/${id}`;
      }),
    ),
  );
}

const roomLink = (map, name) =>
  h(
    "span",
    { class: "row" },
    h("a", { href: `#/maps/${encodeURIComponent(name)}` }, name),
    map && [trustBadge(map), h("span", { class: "muted small" }, t`Expected error`, ": ", expectedError(map))],
    h("a", { class: "small", href: `#/maps/${encodeURIComponent(name)}/names` }, t`Name points`),
  );

/** One floor of a site: its plan, its rooms by name, and who asks for poses on it. */
class Floor {
  constructor(floor, placed, known) {
    this.known = known;
    this.rooms = placed
      .filter((one) => one.floor === floor)
      .map(({ map, pose }) => ({ map, T: matrixOf(pose), walk: [], plan: null, motions: new Motions() }));
    this.canvas = h("canvas", { class: "floor-plan", role: "img", "aria-label": t`Plan of the floor` });
    this.element = h(
      "section",
      { class: "card stack" },
      h("h2", {}, floor ? t`Floor ${floor}` : t`Floor`),
      this.canvas,
      h(
        "div",
        { class: "row" },
        this.rooms.map(({ map }) => roomLink(known.get(map), map)),
      ),
    );
  }

  async load(signal) {
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw(), { signal });
    signal.addEventListener("abort", () => this.unwatch());
    await Promise.all(
      this.rooms.map(async (room) => {
        const fetched = (what, query) => rholoc.bytes(path`v1/maps/${room.map}/${what}`, { signal, query });
        const { views } = readScene(await fetched("scene", { landmarks: 1 }));
        for (let i = 0; i < views.length; i += STRIDE_VIEW) room.walk.push(carried(room.T, views.subarray(i, i + 3)));
        if (this.known.get(room.map)?.room) room.plan = placedPlan(readRoom(await fetched("room")), room.T);
        this.draw();
      }),
    );
  }

  fail(error, signal) {
    if (!signal.aborted) this.element.append(problem(error, null));
  }

  draw() {
    const plans = this.rooms.map(({ plan }) => plan).filter(Boolean);
    const walks = this.rooms.map(({ walk }) => walk);
    drawFloor(this.canvas, plans, walks, endsOf(plans, walks.flat()), (context, place, _scale, colour) => {
      for (const room of this.rooms) drawFrame(context, place, room, colour(this.tint(room.map)), colour);
      const now = performance.now() / 1000;
      for (const { T, motions } of this.rooms)
        for (const robot of motions.now(now, STALE_S, GONE_S)) drawRobot(context, place, T, robot, colour);
    });
  }

  tint(map) {
    const known = this.known.get(map);
    return known ? TINTS[trustOf(known)] : "--muted";
  }

  watch(signal) {
    this.stop = new AbortController();
    signal.addEventListener("abort", () => this.unwatch());
    this.timer = setInterval(() => this.draw(), DRAWN_MS);
    for (const room of this.rooms) if (this.known.get(room.map)?.live) hearRobots(room, this.stop.signal);
  }

  unwatch() {
    this.stop?.abort();
    clearInterval(this.timer);
  }
}

async function hearRobots({ map, motions }, stop) {
  try {
    for await (const answers of rholoc.events(path`v1/maps/${map}/live`, { signal: stop }))
      for (const answer of answers) motions.hear(answer, performance.now() / 1000);
  } catch (error) {
    if (!stop.aborted) tell(error.message, "bad");
  }
}

/** A room's outline in the colour of its trust, and its name. */
function drawFrame(context, place, { map, plan, walk }, tint, colour) {
  const ends = endsOf(plan ? [plan] : [], plan ? [] : walk, 0);
  const [[left, bottom], [right, top]] = [0, 1].map((i) => place([ends[0][i], ends[1][i]]));
  context.strokeStyle = tint;
  context.lineWidth = 2;
  context.strokeRect(left, top, right - left, bottom - top);
  context.font = "600 14px system-ui, sans-serif";
  context.lineWidth = 4;
  context.strokeStyle = colour("--surface");
  context.strokeText(map, left + 6, top + 18);
  context.fillStyle = tint;
  context.fillText(map, left + 6, top + 18);
}

function drawRobot(context, place, T_site_map, { asker, T, stale }, colour) {
  const [x, y] = place(carried(T_site_map, [T[0][3], T[1][3], T[2][3]]));
  context.fillStyle = colour(stale ? "--muted" : "--accent");
  context.beginPath();
  context.arc(x, y, 6, 0, 2 * Math.PI);
  context.fill();
  context.fillStyle = colour("--ink");
  context.font = "12px system-ui, sans-serif";
  context.fillText(asker, x + 9, y + 4);
}

/** A pose of the service as a matrix of three rows. */
const matrixOf = ({ position, quaternion_xyzw }) => rotationOf(quaternion_xyzw).map((row, i) => [...row, position[i]]);

/** Make a site, or choose its maps. */
async function editSite(site, maps = null) {
  const all = maps ?? (await rholoc.get("v1/maps")).maps;
  const name = nameField(site?.name);
  name.readOnly = site !== null;
  const before = new Map((site?.maps ?? []).map((one) => [one.map, one]));
  const rows = all.map((map) => {
    const own = before.get(map.name);
    const chosen = h("input", { type: "checkbox", name: "map", value: map.name, checked: own !== undefined });
    const floor = h("input", {
      name: `floor ${map.name}`,
      value: own?.floor ?? map.labels.floor,
      "aria-label": t`Floor of ${map.name}`,
      placeholder: t`Floor`,
    });
    return h("div", { class: "row" }, h("label", { class: "check" }, chosen, map.name), floor);
  });
  const done = await ask(
    site ? t`Choose maps` : t`New site`,
    [field(t`Name`, name), h("fieldset", { class: "stack" }, h("legend", {}, t`Maps`), rows)],
    h("button", { class: "primary" }, t`Save`),
    (form) => {
      const members = form.getAll("map").map((map) => {
        const { pose = null, given = false } = before.get(map) ?? {};
        return { map, floor: String(form.get(`floor ${map}`) ?? ""), pose: given ? pose : null };
      });
      const kept = new Set(members.map(({ map }) => map));
      const links = (site?.links ?? []).filter(({ first, second }) => kept.has(first) && kept.has(second));
      const body = { maps: members, links, earth: site?.earth ?? null, version: site?.version ?? null };
      return rholoc.call("PUT", path`v1/sites/${mapNameOf(name.value)}`, { body });
    },
  );
  if (!done) return;
  const where = `#/sites/${encodeURIComponent(mapNameOf(name.value))}`;
  if (location.hash === where) dispatchEvent(new HashChangeEvent("hashchange"));
  else location.hash = where;
}

async function removeSite(name) {
  const done = await ask(
    t`Delete the site?`,
    h("p", {}, t`${name}. Its maps stay.`),
    h("button", { class: "danger primary" }, t`Delete`),
    () => rholoc.call("DELETE", path`v1/sites/${name}`),
  );
  if (done) location.hash = "#/sites";
}

const shareVisits = (name) =>
  shareLink(
    t`Link for visitors`,
    t`Whoever has the link finds the way in this site with a phone's camera until it expires, and can do nothing else.`,
    path`here/${name}`,
    { scope: Purpose.VISIT, site: name },
  );

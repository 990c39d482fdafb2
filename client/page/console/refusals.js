// What a map refused lately: how often, from whom, why, and each picture beside the view that it resembles most.

import { objectUrl, path, rholoc } from "../shared/api.js";
import { resolvedColour } from "../shared/colours.js";
import { action, fill, h } from "../shared/dom.js";
import { heard, t } from "../shared/text.js";
import { when } from "./format.js";
import { empty, loading, page, skeletons } from "./parts.js";

const CAUSES = {
  too_dark: t`too dark`,
  blurred: t`blurred`,
  too_little_texture: t`too little texture`,
  other_light: t`other light`,
  wrong_camera: t`focal length`,
  rolled: t`rolled`,
  wrong_gravity: t`gravity`,
  wrong_motion: t`relative poses`,
  too_little_time: t`too little time`,
  inexact_map: t`inexact map`,
  too_inexact: t`too inexact`,
  unknown_place: t`another place`,
};
const HEIGHT = 220; // px, of a picture
const GAP = 24;

export async function showRefusals(main, name, signal) {
  const place = h("div", { class: "stack" }, skeletons(2, "panel"));
  const back = h("a", { class: "button", href: `#/maps/${encodeURIComponent(name)}` }, t`To the map`);
  fill(main, page(t`Refused in ${name}`, back, place));
  await loading(
    place,
    async () => {
      const { refusals } = await rholoc.get(path`v1/maps/${name}/refusals`, { signal });
      fill(place, refusals.length ? overview(name, refusals, signal) : nothing());
    },
    signal,
  );
}

const nothing = () =>
  empty(
    t`Nothing was refused`,
    t`Pictures that this map refuses in the next day are shown here, as far as they are kept.`,
  );

function overview(name, refusals, signal) {
  const hour = ({ time }) => when(3600 * Math.floor(time / 3600));
  return [
    h(
      "div",
      { class: "cards" },
      counts(
        t`By cause`,
        refusals.map(({ cause }) => CAUSES[cause] ?? cause),
      ),
      counts(
        t`By robot`,
        refusals.map(({ asker }) => asker || t`unknown`),
      ),
      counts(t`By hour`, refusals.map(hour)),
    ),
    h(
      "ul",
      { class: "plain stack", "aria-label": t`Refused pictures` },
      refusals.map((refusal) => card(name, refusal, signal)),
    ),
  ];
}

function counts(title, values) {
  const all = new Map();
  for (const value of values) all.set(value, (all.get(value) ?? 0) + 1);
  return h(
    "section",
    { class: "card stack" },
    h("h2", {}, title),
    h(
      "ul",
      { class: "plain" },
      [...all].map(([value, count]) =>
        h("li", { class: "row spread" }, h("span", {}, value), h("span", { class: "mono" }, count)),
      ),
    ),
  );
}

function card(name, refusal, signal) {
  const canvas = h("canvas", { class: "likeness", role: "img", "aria-label": heard(refusal.message) });
  const compare = action(t`Compare with the map`, async () => {
    const found = await rholoc.get(path`v1/maps/${name}/refusals/${refusal.number}`, { signal });
    const both = await draw(canvas, name, refusal, found, signal);
    const why =
      found.view === null ? t`No view of the map resembles it.` : t`This map keeps no pictures to show beside it.`;
    compare.replaceWith(both ? "" : why);
  });
  draw(canvas, name, refusal, { view: null, lines: [] }, signal).catch(() => canvas.remove()); // it is no longer kept
  return h(
    "li",
    { class: "card stack" },
    h(
      "div",
      { class: "row spread" },
      h("span", { class: "badge warn" }, CAUSES[refusal.cause] ?? refusal.cause),
      h("span", { class: "muted small" }, `${refusal.asker} · ${when(refusal.time)}`),
    ),
    h("p", {}, h("strong", {}, heard(refusal.message)), " ", heard(refusal.hint)),
    canvas,
    h("div", { class: "row" }, compare),
  );
}

/**
 * The refused picture and, where one is known and kept, the view beside it, with lines between what was matched.
 * Whether there is a view beside it.
 */
async function draw(canvas, name, { number }, { view, lines }, signal) {
  const ours = await picture(path`v1/maps/${name}/refusals/${number}/picture.jpg`, signal);
  const theirs =
    view === null ? null : await picture(path`v1/maps/${name}/views/${view}/picture.jpg`, signal).catch(() => null);
  const widths = [ours, theirs].map((image) => (image ? (HEIGHT * image.width) / image.height : 0));
  Object.assign(canvas, { width: widths[0] + (theirs ? GAP + widths[1] : 0), height: HEIGHT });
  const context = canvas.getContext("2d");
  context.drawImage(ours, 0, 0, widths[0], HEIGHT);
  if (!theirs) return false;
  context.drawImage(theirs, widths[0] + GAP, 0, widths[1], HEIGHT);
  context.strokeStyle = resolvedColour(canvas, "--warn");
  context.globalAlpha = 0.7;
  for (const [u, v, x, y] of lines) {
    context.beginPath();
    context.moveTo(u * widths[0], v * HEIGHT);
    context.lineTo(widths[0] + GAP + x * widths[1], y * HEIGHT);
    context.stroke();
  }
  return true;
}

async function picture(where, signal) {
  const address = await objectUrl(where, { signal });
  const image = h("img", { src: address });
  await image.decode();
  URL.revokeObjectURL(address);
  return image;
}

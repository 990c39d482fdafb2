// Cameras: intrinsics that frames and recordings refer to by name.

import { path, rholoc } from "../shared/api.js";
import { action, ask, fill, h } from "../shared/dom.js";
import { field, nameField } from "../shared/name_choice.js";
import { coordinates, decimal, t } from "../shared/text.js";
import { empty, loading, page, skeletons } from "./parts.js";

const FIGURES = [
  ["width", t`Width, px`],
  ["height", t`Height, px`],
  ["fx", "fx, px"],
  ["fy", "fy, px"],
  ["cx", "cx, px"],
  ["cy", "cy, px"],
];

const LENSES = { pinhole: t`pinhole`, fisheye: t`fisheye`, equirectangular: t`panorama` };

export async function showCameras(main, _, signal) {
  const list = h("ul", { class: "cards", "aria-label": t`Cameras` }, skeletons(3, "camera-card"));
  const reload = () =>
    loading(list, async () => fillList(list, await rholoc.get("v1/cameras", { signal }), reload), signal);
  fill(
    main,
    page(
      t`Cameras`,
      action(t`Add a camera`, () => edit(null, reload), "primary"),
      h(
        "p",
        { class: "muted" },
        t`A camera's intrinsics under a name. The command rholoc camera calibrate finds them from a filmed board.`,
      ),
      list,
    ),
  );
  await reload();
}

function fillList(list, { cameras, unreadable }, reload) {
  const broken = Object.entries(unreadable).map(([name, why]) =>
    h("li", { class: "notice bad" }, h("strong", {}, name), ": ", why),
  );
  if (!cameras.length && !broken.length) {
    fill(list, h("li", { class: "whole-row" }, empty(t`No cameras yet`, t`Frames of the map's own camera need none.`)));
    return;
  }
  fill(
    list,
    cameras.map((camera) => card(camera, reload)),
    broken,
  );
}

function card(camera, reload) {
  const { rms_px: rms } = camera.calibration;
  return h(
    "li",
    { class: "card stack" },
    h("h2", {}, camera.name),
    h(
      "p",
      { class: "mono" },
      `${camera.width} × ${camera.height}`,
      h("br"),
      `f ${coordinates([camera.fx, camera.fy], 1)}`,
      h("br"),
      `c ${coordinates([camera.cx, camera.cy], 1)}`,
    ),
    h(
      "p",
      { class: "muted small" },
      camera.distortion.length ? t`distortion ${coordinates(camera.distortion, 3)}` : t`no distortion`,
      camera.lens !== "pinhole" && ` · ${LENSES[camera.lens]}`,
      typeof rms === "number" && t` · off by ${decimal(rms, 2)} px`,
    ),
    h(
      "div",
      { class: "row" },
      action(t`Change`, () => edit(camera, reload)),
      action(t`Delete`, () => remove(camera, reload), "danger"),
    ),
  );
}

async function edit(camera, reload) {
  const name = nameField(camera?.name);
  name.readOnly = camera !== null;
  const distortion = h("input", {
    name: "distortion",
    value: camera?.distortion.join(", ") ?? "",
    autocomplete: "off",
  });
  const figures = FIGURES.map(([key, text]) =>
    field(
      text,
      h("input", { name: key, type: "number", step: "any", min: 0, required: true, value: camera?.[key] ?? "" }),
    ),
  );
  const lens = h(
    "select",
    { name: "lens" },
    Object.entries(LENSES).map(([value, text]) => h("option", { value, selected: value === camera?.lens }, text)),
  );
  const done = await ask(
    camera ? t`Change the camera` : t`Add a camera`,
    [
      field(t`Name`, name),
      field(t`Lens`, lens),
      h("div", { class: "form" }, figures),
      field(t`Distortion k1, k2, p1, p2, k3`, distortion, t`empty: none; of a fisheye k1, k2, k3, k4`),
    ],
    h("button", { class: "primary" }, t`Store`),
    (form) => store(form, camera),
  );
  if (done) await reload();
}

function store(form, camera) {
  const body = Object.fromEntries(FIGURES.map(([key]) => [key, Number(form.get(key))]));
  body.distortion = form
    .get("distortion")
    .split(/[\s,]+/)
    .filter(Boolean)
    .map(Number);
  body.lens = form.get("lens");
  if (camera && FIGURES.every(([key]) => body[key] === camera[key])) body.calibration = camera.calibration;
  return rholoc.call("PUT", path`v1/cameras/${form.get("name")}`, { body });
}

async function remove(camera, reload) {
  const done = await ask(
    t`Delete the camera?`,
    h("p", {}, t`${camera.name}. Maps that were made with it keep it.`),
    h("button", { class: "danger primary" }, t`Delete`),
    () => rholoc.call("DELETE", path`v1/cameras/${camera.name}`),
  );
  if (done) await reload();
}

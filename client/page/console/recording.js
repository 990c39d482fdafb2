// One recording: what it is, its waypoints, which can be corrected, and mapping it again.

import { objectUrl, path, rholoc } from "../shared/api.js";
import { action, busy, fill, h, tell } from "../shared/dom.js";
import { field, nameChoice } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { bytes, count, duration, fileNames, when } from "./format.js";
import { facts, loading, page, skeletons, stateBadge } from "./parts.js";

const USUAL_SIGMA_M = 0.02;

export async function showRecording(main, id, signal) {
  const place = h("div", { class: "stack" }, skeletons(1, "panel"));
  fill(main, place);
  await loading(
    place,
    async () => {
      const [recording, { jobs }, { maps }, { cameras }] = await Promise.all(
        [path`v1/recordings/${id}`, "v1/jobs", "v1/maps", "v1/cameras"].map((at) => rholoc.get(at, { signal })),
      );
      const again = jobs.filter((job) => job.recording === id);
      fill(place, overview(recording, again, maps, cameras, signal));
    },
    signal,
  );
}

function overview(recording, jobs, maps, cameras, signal) {
  return page(
    fileNames(recording),
    h("a", { class: "button", href: "#/recordings" }, t`All recordings`),
    h(
      "div",
      { class: "recording-columns" },
      h("section", { class: "card stack" }, h("h2", {}, t`Details`), thumbnail(recording, signal), about(recording)),
      h("section", { class: "card stack" }, h("h2", {}, t`Jobs`), jobList(jobs)),
    ),
    waypoints(recording, signal),
    mapAgain(recording, maps, cameras, signal),
  );
}

/** A small picture of a recording, or a place for it. */
export function thumbnail({ id, thumbnail: there }, signal) {
  const image = h("img", { class: "thumbnail", alt: t`A picture of the recording`, hidden: true });
  if (there) showThumbnail(image, id, signal);
  return h("div", { class: "thumbnail-place" }, image);
}

async function showThumbnail(image, id, signal) {
  try {
    const address = await objectUrl(path`v1/recordings/${id}/thumbnail.jpg`, { signal });
    image.src = address;
    await image.decode();
    URL.revokeObjectURL(address);
    image.hidden = false;
  } catch {
    image.remove(); // it was deleted meanwhile
  }
}

function about({ id, size_bytes: size, created, content }) {
  return facts([
    [t`Length`, content && (content.length_s === null ? t`without times` : duration(content.length_s))],
    [t`Frames`, content && `${count(content.frames)}, ${content.width} × ${content.height}`],
    [t`Motion`, content && (content.imu ? t`accelerometer and gyroscope` : t`not recorded`)],
    [t`Format`, content?.format],
    [t`Size`, bytes(size)],
    [t`Uploaded`, when(created)],
    ["ID", h("code", {}, id)],
  ]);
}

function jobList(jobs) {
  if (!jobs.length) return h("p", { class: "muted" }, t`No job has mapped it.`);
  return h(
    "ul",
    { class: "plain" },
    jobs.map((job) =>
      h(
        "li",
        { class: "row spread" },
        h("a", { href: `#/jobs/${job.id}` }, job.map),
        h("span", { class: "row" }, stateBadge(job), h("span", { class: "muted small" }, when(job.created))),
      ),
    ),
  );
}

/** A table of waypoints to type in; it is saved as a whole. */
function waypoints(recording, signal) {
  const address = path`v1/recordings/${recording.id}/waypoints`;
  const rows = h("tbody", {});
  const add = (waypoint) => rows.append(waypointRow(waypoint));
  const standing = h("p", { class: "small muted" });
  const back = action(t`Take back`, () => change("DELETE"));
  const show = ({ waypoints: given, corrected }) => {
    fill(rows);
    given.forEach(add);
    back.hidden = !corrected;
    standing.textContent = corrected
      ? t`These were typed here and take the place of the recording's own.`
      : t`As they came with the recording.`;
  };
  const change = async (method, body) => {
    show(await rholoc.call(method, address, { body, signal }));
    tell(t`Saved. The recording is mapped with them from now on; maps that there are stay as they are.`);
  };
  show(recording);
  const heads = [t`Name`, "x, m", "y, m", "z, m", t`Time, s`, t`Within, m`, ""];
  return h(
    "section",
    { class: "card stack", "aria-label": t`Waypoints` },
    h("h2", {}, t`Waypoints`),
    standing,
    h(
      "div",
      { class: "scroll", tabindex: 0, role: "group", "aria-label": t`Waypoints` },
      h(
        "table",
        { class: "typed" },
        h("thead", {}, h("tr", {}, ...heads.map((text) => (text ? h("th", { scope: "col" }, text) : h("td", {}))))),
        rows,
      ),
    ),
    h(
      "p",
      { class: "small muted" },
      t`Without a time, the camera paused at each in this order. Three or more, not on one line.`,
    ),
    h(
      "div",
      { class: "row" },
      h(
        "button",
        { type: "button", onclick: () => add({ name: "", position: [0, 0, 0], time_s: null }) },
        t`Add a waypoint`,
      ),
      action(t`Save waypoints`, () => change("PUT", { waypoints: [...rows.children].map(typed) }), "primary"),
      back,
    ),
  );
}

function waypointRow({ name, position, time_s: time, sigma_m: sigma = USUAL_SIGMA_M }) {
  const number = (value, label) => h("input", { type: "number", step: "any", value: value ?? "", "aria-label": label });
  const row = h(
    "tr",
    {},
    h("td", {}, h("input", { value: name, "aria-label": t`Name`, autocomplete: "off", maxlength: 100 })),
    position.map((value, i) => h("td", {}, number(value, "xyz"[i]))),
    h("td", {}, number(time, t`Time, s`)),
    h("td", {}, number(sigma, t`Within, m`)),
    h("td", {}, h("button", { type: "button", onclick: () => row.remove() }, t`Remove`)),
  );
  return row;
}

/** What is typed in a row, as the service takes it. */
function typed(row) {
  const [name, x, y, z, time, sigma] = row.querySelectorAll("input");
  return {
    name: name.value.trim(),
    position: [x, y, z].map((input) => input.valueAsNumber || 0),
    time_s: time.value === "" ? null : time.valueAsNumber,
    sigma_m: sigma.value === "" ? USUAL_SIGMA_M : sigma.valueAsNumber,
  };
}

function mapAgain(recording, maps, cameras, signal) {
  const name = nameChoice({ names: maps.map((map) => map.name) });
  const camera = h(
    "select",
    {},
    h("option", { value: "" }, t`as the recording says`),
    cameras.map((one) => h("option", { value: one.name }, one.name)),
  );
  const frames = h("input", { placeholder: "30:900", autocomplete: "off", pattern: "\\d*:\\d*(:\\d+)?" });
  const button = h("button", { class: "primary" }, t`Map it`);
  return h(
    "form",
    {
      class: "card stack",
      onsubmit: (event) => {
        event.preventDefault();
        busy(button, async () => {
          const body = {
            map: name.value,
            kind: name.kind,
            camera: camera.value || null,
            frames: frames.value.trim() || null,
          };
          try {
            const job = await rholoc.call("POST", path`v1/recordings/${recording.id}/jobs`, { body, signal });
            location.hash = `#/jobs/${job.id}`;
          } catch (error) {
            if (!signal.aborted) tell(error.message, "bad");
          }
        });
      },
    },
    h("h2", {}, t`Map it again`),
    h(
      "div",
      { class: "form" },
      name.element,
      field(t`Camera`, camera),
      field(t`Only these frames`, frames, t`From and to, by number; empty for all`),
    ),
    h("div", { class: "row" }, button),
  );
}

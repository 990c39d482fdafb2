// The measured points of a walk, to be typed before, while or after recording.

import { fill, h } from "../../shared/dom.js";
import { t } from "../../shared/text.js";
import { added, coordinate } from "../waypoints.js";
import { duration } from "./words.js";

const AXES = ["x", "y", "z"];

/** Waypoints that can be edited. `changed` hears of each change; `started` is when the recording did, on the clock. */
export function waypointList(waypoints, changed, started = 0) {
  const list = h("ul", { class: "points" });

  function set(next) {
    waypoints = next;
    fill(list, waypoints.map(item));
    changed(waypoints);
  }

  /** As `set`, but the fields stay: someone types in one. */
  function type(row, values) {
    waypoints = waypoints.with(row, { ...waypoints[row], ...values });
    changed(waypoints);
  }

  function item({ name, time, position }, row) {
    const named = h("input", {
      "aria-label": t`Name of point ${row + 1}`,
      value: name,
      maxlength: 40,
      oninput: () => type(row, { name: named.value.trim() }),
    });
    const unmark = () => set(waypoints.with(row, { ...waypoints[row], time: null }));
    return h(
      "li",
      {},
      named,
      position.map((value, axis) => number(row, axis, value)),
      time === null
        ? h("span", { class: "mark muted small" }, t`not marked`)
        : h(
            "button",
            { type: "button", class: "mark", "aria-label": t`Unmark ${name}`, onclick: unmark },
            duration(time - started),
            h("span", { class: "muted" }, "✕"),
          ),
      h(
        "button",
        {
          type: "button",
          class: "remove",
          "aria-label": t`Remove ${name}`,
          onclick: () => set(waypoints.toSpliced(row, 1)),
        },
        t`Remove`,
      ),
    );
  }

  function number(row, axis, value) {
    const field = h("input", {
      inputmode: "text", // the decimal keyboards of phones have no minus
      autocomplete: "off",
      placeholder: `${AXES[axis]} m`,
      "aria-label": t`${AXES[axis]} of ${waypoints[row].name} in metres`,
      value: value === null ? "" : String(value),
      oninput: () => {
        const typed = coordinate(field.value);
        field.setAttribute("aria-invalid", String(typed === null && field.value.trim() !== ""));
        type(row, { position: waypoints[row].position.with(axis, typed) });
      },
    });
    return field;
  }

  fill(list, waypoints.map(item));
  return h(
    "div",
    { class: "stack" },
    h(
      "p",
      { class: "small muted" },
      t`Where the camera is at a point, in metres, z up. Three or more that are not on one line give the map your axes; without them it has its own.`,
    ),
    list,
    h("div", {}, h("button", { type: "button", onclick: () => set(added(waypoints)) }, t`Add a point`)),
  );
}

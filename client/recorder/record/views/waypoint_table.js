// The measured points of a walk, to be typed before, while or after recording.

import { fill, h } from "../../shared/dom.js";
import { coordinate, empty, freeName } from "../waypoints.js";
import { duration } from "./words.js";

const AXES = ["x", "y", "z"];

/**
 * A table of waypoints that can be edited. `changed` hears of each change; `started` is the clock's reading at the
 * recording's start, from which marks are told. The element's `show(waypoints)` shows others.
 */
export function waypointTable(waypoints, changed, started = 0) {
  const body = h("tbody");
  const element = h(
    "div",
    { class: "stack" },
    h(
      "p",
      { class: "small muted" },
      "Where the camera is at a point, in metres, z up. Three or more that are not on one line give the map your frame; without them it gets one of its own.",
    ),
    h(
      "div",
      { class: "scroll" },
      h(
        "table",
        { class: "waypoints" },
        h("thead", {}, h("tr", {}, ["Point", ...AXES.map((axis) => `${axis} (m)`), "Marked", ""].map((text) => h("th", { scope: "col" }, text)))),
        body,
      ),
    ),
    h("div", {}, h("button", { type: "button", onclick: () => set([...waypoints, empty(freeName(waypoints))]) }, "Add a point")),
  );

  function set(next, redraw = true) {
    waypoints = next;
    if (redraw) draw();
    changed(waypoints);
  }

  function change(row, values) {
    set(waypoints.with(row, { ...waypoints[row], ...values }), false);
  }

  function number(row, axis) {
    const { name, position } = waypoints[row];
    const field = h("input", {
      inputmode: "text", // the decimal keyboards of phones have no minus
      autocomplete: "off",
      "aria-label": `${AXES[axis]} of ${name} in metres`,
      value: position[axis] === null ? "" : String(position[axis]),
      oninput: () => {
        const value = coordinate(field.value);
        field.setAttribute("aria-invalid", String(value === null && field.value.trim() !== ""));
        change(row, { position: waypoints[row].position.with(axis, value) });
      },
    });
    return field;
  }

  function draw() {
    fill(
      body,
      waypoints.map(({ name, time }, row) =>
        h(
          "tr",
          {},
          h("td", {}, h("input", { "aria-label": `Name of point ${row + 1}`, value: name, maxlength: 40, oninput: ({ target }) => change(row, { name: target.value.trim() }) })),
          AXES.map((_, axis) => h("td", {}, number(row, axis))),
          h(
            "td",
            {},
            time === null
              ? h("span", { class: "muted" }, "–")
              : h("button", { type: "button", "aria-label": `Unmark ${name}`, title: "Unmark", onclick: () => set(waypoints.with(row, { ...waypoints[row], time: null })) }, duration(time - started), " ✕"),
          ),
          h("td", {}, h("button", { type: "button", "aria-label": `Remove ${name}`, title: "Remove", onclick: () => set(waypoints.toSpliced(row, 1)) }, "🗑")),
        ),
      ),
    );
  }

  draw();
  element.show = (next) => {
    waypoints = next;
    draw();
  };
  return element;
}

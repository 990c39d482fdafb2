// A recording looked at before it is sent.

import { fill, h } from "../../shared/dom.js";
import { DARKEST, LEAST_RATE_HZ } from "../coaching.js";
import { rate } from "../motion.js";
import { archive, SHORTEST_S, videoOf } from "../recording.js";
import { State } from "../store.js";
import { Ending, ENDINGS } from "../take.js";
import { problem } from "../waypoints.js";
import { cameraField } from "./camera_field.js";
import { mapNameField } from "./map_name.js";
import { waypointList } from "./waypoint_list.js";
import { duration, moment, percent, size } from "./words.js";

/** Video, figures, doubts, points; then it is sent, kept or deleted. */
export async function reviewView({ content, store, id }) {
  let recording = await store.recording(id);
  if (!recording || ![State.RECORDING, State.STOPPED].includes(recording.state)) return void (location.hash = "#/");
  if (recording.state === State.RECORDING) recording = await store.save({ ...recording, state: State.STOPPED, ending: Ending.BROKEN });
  const parts = await store.parts(id);
  const address = URL.createObjectURL(videoOf(recording, parts));
  const imuHz = rate(parts.flatMap((part) => part.imu.map((row) => row[0])));
  const doubts = h("ul", { class: "stack doubts" });
  const tooShort = recording.duration < SHORTEST_S;
  const keep = async (changes) => {
    recording = await store.save({ ...recording, ...changes });
    showDoubts();
  };

  function showDoubts() {
    fill(doubts, doubtsOf(recording, imuHz).map((text) => h("li", { class: "notice warn" }, text)));
  }

  async function send(event) {
    event.preventDefault();
    event.submitter.disabled = true;
    await store.save({ ...recording, state: State.SENDING });
    location.hash = `#/send/${id}`;
  }

  async function saveFile() {
    const file = URL.createObjectURL(await archive(recording, parts));
    h("a", { href: file, download: `${recording.map}.zip` }).click();
    setTimeout(() => URL.revokeObjectURL(file), 60_000);
  }

  showDoubts();
  fill(
    content,
    h(
      "form",
      { class: "stack narrow", onsubmit: send },
      h("h1", {}, "Your recording"),
      tooShort && h("p", { class: "notice bad", role: "alert" }, `${recording.duration.toFixed(0)} s is too short for a map: walk for ${SHORTEST_S} s at the least, half a minute or more for a room.`),
      doubts,
      h("video", { class: "review", src: address, controls: true, playsinline: true, preload: "metadata", "aria-label": "The recording" }),
      facts(recording, imuHz),
      h("details", { open: recording.waypoints.some((waypoint) => waypoint.time !== null) }, h("summary", {}, "Measured points"), waypointList(recording.waypoints, (waypoints) => keep({ waypoints }), recording.started)),
      mapNameField(recording.map, (map) => keep({ map })),
      cameraField(recording.camera, (camera) => keep({ camera })),
      h(
        "label",
        {},
        "What becomes of it",
        h(
          "select",
          { onchange: ({ target }) => keep({ kind: target.value }) },
          h("option", { value: "build" }, "A new map; one of this name is replaced"),
          h("option", { value: "update", selected: recording.kind === "update" }, "The map of this name learns it"),
        ),
      ),
      h(
        "div",
        { class: "row" },
        h("button", { class: "primary", disabled: tooShort }, "Send"),
        h("a", { class: "button", href: "#/live" }, "Record again"),
        h("button", { type: "button", onclick: saveFile }, "Save as a file"),
        h("a", { class: "button", href: "#/" }, "Later"),
      ),
    ),
  );
  return () => URL.revokeObjectURL(address);
}

function doubtsOf(recording, imuHz) {
  return [
    ENDINGS[recording.ending],
    imuHz === 0
      ? "No motion sensors: the map's scale comes from measured points alone."
      : imuHz < LEAST_RATE_HZ && `The motion sensors reported ${Math.round(imuHz)} times a second; ${LEAST_RATE_HZ} are needed.`,
    Number.isFinite(recording.darkest) && recording.darkest < DARKEST && "Parts of it are dark. The map may have gaps there.",
    problem(recording.waypoints),
  ].filter(Boolean);
}

function facts(recording, imuHz) {
  const pairs = {
    Recorded: moment(recording.created),
    Length: duration(recording.duration),
    Size: size(recording.bytes),
    Sensors: imuHz ? `${Math.round(imuHz)} Hz` : "none",
    "Darkest light": Number.isFinite(recording.darkest) ? percent(recording.darkest) : "unknown",
  };
  return h("dl", { class: "facts" }, Object.entries(pairs).flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]));
}

// A recording looked at before it is sent.

import { fill, h } from "../../shared/dom.js";
import { nameChoice } from "../../shared/name_choice.js";
import { decimal, percent, t, when } from "../../shared/text.js";
import { DARKEST, Flaw, LEAST_RATE_HZ } from "../coaching.js";
import { mapNames } from "../map_names.js";
import { rate } from "../motion.js";
import { flawedSpans } from "../readings.js";
import { archive, SHORTEST_S, videoOf } from "../recording.js";
import { State } from "../store.js";
import { ENDINGS, Ending } from "../take.js";
import { problem } from "../waypoints.js";
import { cameraField } from "./camera_field.js";
import { waypointList } from "./waypoint_list.js";
import { duration, size } from "./words.js";

const FLAWS = {
  [Flaw.TOO_FAST]: t`turned too fast`,
  [Flaw.TOO_DARK]: t`too dark`,
  [Flaw.BLURRED]: t`blurred`,
  [Flaw.BARE]: t`nothing to recognise`,
};
const LOOP_EXPECTED_S = 20; // of a walk; a shorter one has hardly left
const MUCH = 0.25; // of a walk's seconds; where more have a flaw, it is better walked again

/** Video, figures, doubts, points; then it is sent, kept or deleted. */
export async function reviewView({ content, store, id }) {
  let recording = await store.recording(id);
  if (!recording || ![State.RECORDING, State.STOPPED].includes(recording.state)) return void (location.hash = "#/");
  if (recording.state === State.RECORDING)
    recording = await store.save({ ...recording, state: State.STOPPED, ending: Ending.BROKEN });
  const parts = await store.parts(id);
  const address = URL.createObjectURL(videoOf(recording, parts));
  const imuHz = rate(parts.flatMap((part) => part.imu.map((row) => row[0])));
  const doubts = h("ul", { class: "stack doubts" });
  const tooShort = recording.duration < SHORTEST_S;
  const keep = async (changes) => {
    recording = await store.save({ ...recording, ...changes });
    showDoubts();
  };
  const video = h("video", {
    class: "review",
    src: address,
    controls: true,
    playsinline: true,
    preload: "metadata",
    "aria-label": t`The recording`,
  });
  const name = nameChoice({
    value: recording.map,
    kind: recording.kind,
    changed: () => name.input.checkValidity() && keep({ map: name.value, kind: name.kind }),
  });
  mapNames().then((names) => names && name.know(names));

  function showDoubts() {
    fill(
      doubts,
      doubtsOf(recording, imuHz).map((text) => h("li", { class: "notice warn" }, text)),
    );
  }

  async function send(event) {
    event.preventDefault();
    event.submitter.disabled = true;
    const { value: map, kind, asked } = name;
    await store.save({ ...recording, map, kind, asked, state: State.SENDING });
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
      h("h1", {}, t`Your recording`),
      tooShort &&
        h(
          "p",
          { class: "notice bad", role: "alert" },
          t`${decimal(recording.duration)} s is too short for a map: walk for at least ${SHORTEST_S} s, half a minute or more for a room.`,
        ),
      doubts,
      video,
      flawedSeconds(recording.seconds ?? [], video),
      facts(recording, imuHz),
      h(
        "details",
        { open: recording.waypoints.some((waypoint) => waypoint.time !== null) },
        h("summary", {}, t`Measured points`),
        waypointList(recording.waypoints, (waypoints) => keep({ waypoints }), recording.started),
      ),
      name.element,
      cameraField(recording.camera, (camera) => keep({ camera })),
      h(
        "div",
        { class: "row" },
        h("button", { class: "primary", disabled: tooShort }, t`Send`),
        h("a", { class: "button", href: "#/live" }, t`Record again`),
        h("button", { type: "button", onclick: saveFile }, t`Save as a file`),
        h("a", { class: "button", href: "#/" }, t`Later`),
      ),
    ),
  );
  return () => URL.revokeObjectURL(address);
}

/** Which seconds the map will not be made of, each a button that shows them. */
function flawedSeconds(seconds, video) {
  const spans = flawedSpans(seconds);
  if (!spans.length) return null;
  const show = (from) => {
    video.currentTime = from;
    video.scrollIntoView({ block: "center" });
  };
  const bad = seconds.filter((flaws) => flaws.length).length;
  return h(
    "section",
    { class: "card stack", "aria-label": t`Seconds that will fail` },
    h("h2", {}, t`Seconds that will fail`),
    h(
      "div",
      { class: "timeline", "aria-hidden": "true" },
      seconds.map((flaws) => h("span", { class: flaws.length ? "bad" : "" })),
    ),
    bad > MUCH * seconds.length &&
      h("p", { class: "notice warn" }, t`They are ${percent(bad / seconds.length)} of the walk: better walk again.`),
    h(
      "ul",
      { class: "plain row" },
      spans.map(({ flaw, from, to }) =>
        h(
          "li",
          {},
          h("button", { type: "button", onclick: () => show(from) }, `${duration(from)}–${duration(to)} `, FLAWS[flaw]),
        ),
      ),
    ),
  );
}

function doubtsOf(recording, imuHz) {
  return [
    ENDINGS[recording.ending],
    imuHz === 0
      ? t`No motion sensors: the map's scale comes from measured points alone.`
      : imuHz < LEAST_RATE_HZ &&
        t`The motion sensors reported ${Math.round(imuHz)} times a second; ${LEAST_RATE_HZ} are needed.`,
    Number.isFinite(recording.darkest) &&
      recording.darkest < DARKEST &&
      t`Parts of it are dark. The map may have gaps there.`,
    recording.views === 1 && t`The camera saw only one view: it stood still. A map needs a walk through the room.`,
    recording.loops === 0 &&
      recording.duration > LOOP_EXPECTED_S &&
      t`No loop was seen: the walk did not come back to where it had been, or not long enough. The map will not know its own errors.`,
    problem(recording.waypoints),
  ].filter(Boolean);
}

function facts(recording, imuHz) {
  const pairs = [
    [t`Recorded`, when(recording.created)],
    [t`Length`, duration(recording.duration)],
    [t`Size`, size(recording.bytes)],
    [t`Sensors`, imuHz ? `${Math.round(imuHz)} Hz` : t`none`],
    [t`Darkest light`, Number.isFinite(recording.darkest) ? percent(recording.darkest) : t`unknown`],
  ];
  return h(
    "dl",
    { class: "facts" },
    pairs.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]),
  );
}

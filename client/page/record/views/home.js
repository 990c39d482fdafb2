// What there is on this phone, and the way to a new recording.

import { rholoc } from "../../shared/api.js";
import { ask, busy, fill, h } from "../../shared/dom.js";
import { field, mapNameOf, nameField } from "../../shared/name_choice.js";
import { t, when } from "../../shared/text.js";
import { draft, keepDraft } from "../draft.js";
import { missing } from "../problem.js";
import { askForSensors } from "../sensors.js";
import { State } from "../store.js";
import { guide } from "./guide.js";
import { onPhone } from "./on_phone.js";
import { waypointList } from "./waypoint_list.js";
import { duration, size } from "./words.js";

const LITTLE_ROOM_BYTES = 300e6;

/** The first page. */
export async function homeView({ content, store, id, place }) {
  if (id) keepDraft({ map: decodeURIComponent(id) });
  const recordings = await store.recordings();
  const { map, waypoints } = draft();
  const lack = missing();
  const name = nameField(map);
  name.addEventListener("input", () => name.checkValidity() && keepDraft({ map: mapNameOf(name.value) }));
  const open = h("button", { class: "primary", disabled: lack !== null }, t`Open the camera`);
  const form = h(
    "form",
    {
      class: "card stack",
      onsubmit: (event) => {
        event.preventDefault();
        askForSensors(); // now, in answer to the tap
        busy(open, async () => {
          if (await mayUpload()) location.hash = "#/live";
        });
      },
    },
    h("h2", {}, t`New recording`),
    field(t`Name of the map`, name),
    h(
      "details",
      {},
      h("summary", {}, t`Measured points (optional)`),
      waypointList(waypoints, (changed) => keepDraft({ waypoints: changed })),
    ),
    open,
  );
  fill(
    content,
    h(
      "div",
      { class: "stack narrow" },
      h("h1", {}, t`Record a walk`),
      lack &&
        h(
          "div",
          { class: "notice bad stack", role: "alert" },
          h("p", {}, h("strong", {}, lack.title), " ", lack.advice),
          h("div", { class: "row" }, h("a", { class: "button", href: "./#/recordings" }, t`Upload a walk`)),
        ),
      await roomNotice(),
      place && walkHere(draft().map, place),
      lack ? null : onPhone(),
      form,
      guide(),
      recordings.length > 0 && h("h2", {}, t`On this phone`),
      recordings.length > 0 &&
        h(
          "ul",
          { class: "cards recordings" },
          recordings.map((recording) => card(recording, store)),
        ),
    ),
  );
}

/** Whether this browser may upload. A key is asked for where one is needed; a server that is away is no obstacle yet. */
async function mayUpload() {
  try {
    await rholoc.request("OPTIONS", "v1/recordings");
  } catch (error) {
    return error.status !== 401 && error.status !== 403;
  }
  return true;
}

/** Where a further walk of a map is to go. */
function walkHere(map, place) {
  const [x, y, degrees] = place.split(",");
  return h(
    "p",
    { class: "notice good" },
    t`For the map ${map}: begin where it works, walk to about ${x}, ${y}, look to ${degrees}°, and come back. Before sending, choose that the map learns it.`,
  );
}

async function roomNotice() {
  const { quota, usage } = (await navigator.storage?.estimate?.()) ?? {};
  if (!quota || quota - usage > LITTLE_ROOM_BYTES) return null;
  return h(
    "p",
    { class: "notice warn" },
    t`This phone's storage is almost full: ${size(quota - usage)} left. A minute takes about 60 MB.`,
  );
}

function card(recording, store) {
  const { id, state, map, job } = recording;
  const [badge, kind, action, address] = {
    [State.RECORDING]: [t`broken off`, "warn", t`Look at it`, `#/review/${id}`],
    [State.STOPPED]: [t`not sent`, "warn", t`Look at it`, `#/review/${id}`],
    [State.SENDING]: [t`not sent yet`, "warn", t`Go on sending`, `#/send/${id}`],
    [State.UPLOADED]: [t`sent`, "good", t`See its job`, `#/send/${id}`],
  }[state];
  const item = h(
    "li",
    { class: "card stack" },
    h("div", { class: "row spread" }, h("strong", {}, map), h("span", { class: ["badge", kind] }, badge)),
    h(
      "p",
      { class: "muted small" },
      `${when(recording.created)} · ${duration(recording.duration)} · ${size(recording.bytes)}`,
    ),
    h(
      "div",
      { class: "row" },
      h("a", { class: "button", href: address }, action),
      h(
        "button",
        { class: "danger", onclick: () => remove(recording, store, item) },
        job ? t`Remove from the list` : t`Delete`,
      ),
    ),
  );
  return item;
}

async function remove(recording, store, item) {
  const lost = recording.state !== State.UPLOADED;
  const sure =
    !lost ||
    (await ask(
      t`Delete this recording?`,
      h("p", {}, t`It is only on this phone.`),
      h("button", { class: "danger primary" }, t`Delete`),
    ));
  if (!sure) return;
  await store.remove(recording.id);
  item.remove();
}

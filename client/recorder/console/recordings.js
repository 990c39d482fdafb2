// Recordings: uploaded, and what is kept of them.

import { call, get, path } from "../shared/api.js";
import { ask, fill, h } from "../shared/dom.js";
import { upload } from "../record/upload.js";
import { bytes, when } from "./format.js";
import { action, empty, field, loading, nameField, page, skeletons, tell } from "./parts.js";

export async function showRecordings(main, _, signal) {
  const list = h("div", {}, skeletons(3, "line"));
  const reload = () =>
    loading(list, async () => fillList(list, await get("v1/recordings", { signal }), reload), signal);
  fill(
    main,
    page(
      "Recordings",
      h("a", { class: "button", href: "record" }, "Record a walk"),
      uploadForm(signal),
      h("h2", {}, "Kept here"),
      list,
    ),
  );
  await reload();
}

function uploadForm(signal) {
  const file = h("input", { type: "file", name: "file", required: true, accept: "video/*,.zip,.mkv" });
  const name = nameField();
  const kind = h(
    "select",
    { name: "kind" },
    h("option", { value: "build" }, "make a new map"),
    h("option", { value: "update" }, "teach it to the map of that name"),
  );
  const bar = h("progress", { max: 1, value: 0, "aria-label": "Upload" });
  const standing = h("p", { class: "muted small", role: "status" }, "A video, or a recording as a ZIP file.");
  const button = h("button", { class: "primary" }, "Upload");
  return h(
    "form",
    {
      class: "card stack",
      onsubmit: async (event) => {
        event.preventDefault();
        const [blob] = file.files;
        const hear = ({ sent, waiting }) => {
          if (sent !== undefined) {
            bar.value = blob.size ? sent / blob.size : 1;
            standing.textContent = `${bytes(sent)} of ${bytes(blob.size)}`;
          }
          if (waiting) standing.textContent = `${waiting.message} It goes on by itself.`;
        };
        button.disabled = true;
        try {
          const job = await upload(blob, {
            metadata: { filename: blob.name, map: name.value, kind: kind.value },
            location: null,
            hear,
            signal,
          });
          location.hash = `#/jobs/${job}`;
        } catch (error) {
          if (!signal.aborted) tell(error.message, "bad");
        } finally {
          button.disabled = false;
        }
      },
    },
    h("h2", {}, "Upload a walk"),
    h("div", { class: "form" }, field("Recording", file), field("Map", name), field("What for", kind), button),
    bar,
    standing,
  );
}

function fillList(place, { recordings }, reload) {
  if (!recordings.length) {
    fill(
      place,
      empty(
        "No recordings yet",
        "They are kept after their map is made, so that a job can be tried again and other maps can learn them.",
        h("a", { class: "button primary", href: "record" }, "Record a walk"),
      ),
    );
    return;
  }
  fill(
    place,
    h(
      "div",
      { class: "scroll", tabindex: 0, role: "group", "aria-label": "Recordings" },
      h(
        "table",
        {},
        h(
          "thead",
          {},
          h(
            "tr",
            {},
            ["Files", "Size", "Uploaded", "Actions"].map((text) => h("th", { scope: "col" }, text)),
          ),
        ),
        h(
          "tbody",
          {},
          recordings.map((one) =>
            h(
              "tr",
              {},
              h(
                "td",
                {},
                one.files.slice(0, 3).join(", "),
                one.files.length > 3 && ` and ${one.files.length - 3} more`,
                h("br"),
                h("code", { class: "muted", title: one.id }, one.id.slice(0, 8)),
              ),
              h("td", {}, bytes(one.size_bytes)),
              h("td", {}, when(one.created)),
              h(
                "td",
                {},
                action("Delete", () => remove(one, reload), "danger"),
              ),
            ),
          ),
        ),
      ),
    ),
  );
}

async function remove(recording, reload) {
  const done = await ask(
    "Delete the recording?",
    h("p", {}, recording.files[0], ", ", bytes(recording.size_bytes), ". Maps made of it stay."),
    h("button", { class: "danger primary" }, "Delete"),
    () => call("DELETE", path`v1/recordings/${recording.id}`),
  );
  if (done) await reload();
}

// A recording on its way to the server, and its job there.

import { fill, h } from "../../shared/dom.js";
import { followJob } from "../job.js";
import { archive } from "../recording.js";
import { State } from "../store.js";
import { upload } from "../upload.js";
import { percent, size } from "./words.js";

const STAGES = {
  received: "Received",
  read: "Reading the recording",
  keyframes: "Choosing keyframes",
  features: "Finding features",
  poses: "Finding where each frame was taken",
  observations: "Linking observations",
  densities: "Fitting densities",
  report: "Testing the map",
  published: "Published",
};

/** Upload, going on where an earlier try stood; then the job, stage by stage. */
export async function sendView({ content, store, id }) {
  const recording = await store.recording(id);
  if (!recording) return void (location.hash = "#/");
  const page = new SendPage(recording);
  fill(content, page.element);
  const leaving = new AbortController();
  run(page, store, recording, leaving.signal).catch((error) => {
    if (!leaving.signal.aborted) page.failed(error, () => location.reload());
  });
  return () => leaving.abort();
}

async function run(page, store, recording, signal) {
  if (recording.state !== State.UPLOADED) recording = await send(page, store, recording, signal);
  page.sent();
  page.ended(await followJob(recording.job, (job) => page.jobChanged(job), signal));
}

/** The description of the uploaded recording, whose parts are not needed any more. */
async function send(page, store, recording, signal) {
  const file = await archive(recording, await store.parts(recording.id));
  const hear = async ({ sent, location, waiting }) => {
    if (sent !== undefined) page.sending(sent, file.size);
    if (waiting) page.waiting(waiting);
    if (location !== undefined) await store.save(Object.assign(recording, { location }));
  };
  const { map, kind = "build", camera } = recording;
  const metadata = { filename: `${map}.zip`, map, kind, ...(camera && { camera }) };
  const job = await upload(file, { metadata, location: recording.location ?? null, hear, signal });
  const uploaded = { ...recording, state: State.UPLOADED, job };
  await store.dropParts(uploaded);
  return uploaded;
}

class SendPage {
  constructor(recording) {
    this.title = h("h1", {}, "Sending");
    this.bar = h("progress", { max: 1, value: "0", "aria-label": "Progress" });
    this.text = h("p", { role: "status" }, "Getting ready …");
    this.notice = h("div", { class: "notice warn", role: "alert", hidden: true });
    this.stages = h("ol", { class: "stages", hidden: true }, Object.entries(STAGES).map(([stage, words]) => h("li", { "data-stage": stage }, words)));
    this.actions = h("div", { class: "row" });
    this.closing = h("p", { class: "muted" }, "You may close this page: sending goes on when you open it again.");
    this.element = h(
      "div",
      { class: "stack narrow" },
      this.title,
      h("p", { class: "muted" }, "For the map ", h("strong", {}, recording.map)),
      this.closing,
      this.bar,
      this.text,
      this.notice,
      this.stages,
      this.actions,
    );
  }

  sending(sent, whole) {
    this.notice.hidden = true;
    this.bar.value = sent / whole;
    this.text.textContent = `${size(sent)} of ${size(whole)}, ${percent(sent / whole)}`;
  }

  waiting(error) {
    if (!this.bar.value) this.text.textContent = "Not begun yet.";
    this.notice.hidden = false;
    fill(this.notice, h("strong", {}, "The server cannot be reached."), " Nothing is lost: sending goes on by itself when it can. ", h("span", { class: "muted" }, error.summary));
  }

  sent() {
    this.title.textContent = "The server makes the map";
    this.notice.hidden = true;
    this.closing.hidden = true;
    this.stages.hidden = false;
    this.text.textContent = "Sent. It is no longer needed on this phone.";
    this.bar.removeAttribute("value");
  }

  jobChanged({ stage, progress, message, state }) {
    this.bar.value = progress;
    this.text.textContent = state === "queued" ? "Waiting for a worker" : message || STAGES[stage];
    const items = [...this.stages.children];
    const now = items.findIndex((item) => item.dataset.stage === stage);
    items.forEach((item, i) => {
      item.className = i < now || state === "published" ? "done" : i === now ? "now" : "";
      if (i === now) item.setAttribute("aria-current", "step");
      else item.removeAttribute("aria-current");
    });
  }

  ended({ state, error, map }) {
    const again = h("a", { class: "button", href: "#/" }, "Record another");
    if (state === "published") {
      const where = encodeURIComponent(map);
      this.title.textContent = "The map is ready";
      this.text.textContent = "";
      fill(this.actions, h("a", { class: "button primary", href: `./#/maps/${where}` }, "See the map"), h("a", { class: "button", href: `./#/try/${where}` }, "Try it"), again);
      return;
    }
    this.title.textContent = state === "cancelled" ? "The job was cancelled" : "No map came of it";
    this.bar.hidden = true;
    this.tell(error ?? { message: "The server keeps the recording.", hint: "" });
    fill(this.actions, h("a", { class: "button", href: "./#/jobs" }, "All jobs"), again);
  }

  failed(error, again) {
    this.title.textContent = "It could not be sent";
    this.closing.hidden = true;
    this.text.textContent = "The recording is still on this phone.";
    this.tell({ message: error.summary ?? error.message, hint: error.hint ?? "" });
    fill(this.actions, h("button", { class: "primary", onclick: again }, "Try again"), h("a", { class: "button", href: "#/" }, "Later"));
  }

  tell({ message, hint }) {
    this.notice.hidden = false;
    this.notice.className = "notice bad";
    fill(this.notice, h("strong", {}, message), " ", hint);
  }
}

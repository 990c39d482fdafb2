// Keeps the recorder on the phone: fresh from the server while that answers, else as it was last time.

const CACHE = "rholoc-recorder";
const worker = /** @type {any} */ (self);
const WEB = new URL("../", self.location.href);
const PAGE = new URL("../record", WEB);
const CLIENT = new URL("../js/", WEB);
const FILES = [
  "../js/client.js",
  "../js/track.js",
  "record/camera.js",
  "record/clock.js",
  "record/coaching.js",
  "record/container.js",
  "record/draft.js",
  "record/headings.js",
  "record/icon-192.png",
  "record/loop_watch.js",
  "record/loop_worker.js",
  "record/main.js",
  "record/manifest.webmanifest",
  "record/map_names.js",
  "record/motion.js",
  "record/place_memory.js",
  "record/problem.js",
  "record/readings.js",
  "record/record.css",
  "record/recording.js",
  "record/sensors.js",
  "record/store.js",
  "record/tables.js",
  "record/take.js",
  "record/views/camera_field.js",
  "record/views/guide.js",
  "record/views/home.js",
  "record/views/live.js",
  "record/views/meters.js",
  "record/views/on_phone.js",
  "record/views/review.js",
  "record/views/ring.js",
  "record/views/send.js",
  "record/views/waypoint_list.js",
  "record/views/words.js",
  "record/waypoints.js",
  "record/zip.js",
  "shared/api.js",
  "shared/dom.js",
  "shared/handover.js",
  "shared/icon.svg",
  "shared/job_words.js",
  "shared/name_choice.js",
  "shared/style.css",
  "shared/text.js",
  "shared/texts.js",
  "shared/trust.js",
];

worker.addEventListener("install", (event) => {
  worker.skipWaiting();
  event.waitUntil(
    caches.open(CACHE).then((cache) => cache.addAll([PAGE, ...FILES.map((file) => new URL(file, WEB))].map(String))),
  );
});

worker.addEventListener("activate", (event) => event.waitUntil(worker.clients.claim()));

worker.addEventListener("fetch", (event) => {
  const { request } = event;
  const where = new URL(request.url);
  const ours = where.pathname === PAGE.pathname || [WEB, CLIENT].some(({ href }) => where.href.startsWith(href));
  if (request.method === "GET" && ours) event.respondWith(freshOrKept(request));
});

async function freshOrKept(request) {
  const cache = await caches.open(CACHE);
  try {
    const response = await fetch(request);
    if (response.ok) await cache.put(request, response.clone());
    return response;
  } catch (error) {
    const kept = await cache.match(request, { ignoreSearch: true });
    if (kept) return kept;
    throw error;
  }
}

import assert from "node:assert/strict";
import { test } from "node:test";

import {
  Axes,
  camera,
  cameraOfProjection,
  Client,
  inverse,
  MapSession,
  multiply,
  path,
  RholocError,
  toOpenCV,
  turned,
} from "../../client/js/index.js";

const IDENTITY = [0, 1, 2, 3].map((i) => [0, 1, 2, 3].map((j) => Number(i === j)));
const near = (A, B, within = 1e-9) =>
  A.forEach((row, i) => row.forEach((value, j) => assert.ok(Math.abs(value - B[i][j]) <= within, `${A} is not ${B}`)));

/** A generator of numbers from a normal distribution. */
function normal(seed) {
  let state = seed + 1;
  const uniform = () => ((state = (state * 48271) % 2147483647) / 2147483647);
  return () => Math.sqrt(-2 * Math.log(uniform())) * Math.cos(2 * Math.PI * uniform());
}

function pose([ax, ay, az], [x, y, z]) {
  const angle = Math.hypot(ax, ay, az) || 1e-12;
  const [u, v, w] = [ax / angle, ay / angle, az / angle];
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const k = 1 - c;
  return [
    [c + u * u * k, u * v * k - w * s, u * w * k + v * s, x],
    [v * u * k + w * s, c + v * v * k, v * w * k - u * s, y],
    [w * u * k - v * s, w * v * k + u * s, c + w * w * k, z],
    [0, 0, 0, 1],
  ];
}

const COLUMNS = (T) => Float64Array.from({ length: 16 }, (_, k) => T[k % 4][Math.floor(k / 4)]);

test("poses of every framework become the service's", () => {
  const T = pose([0.3, -0.2, 0.5], [1, 2, 3]);
  near(toOpenCV(T, Axes.OPENCV), T);
  const opengl = multiply(T, [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]);
  near(toOpenCV(COLUMNS(opengl), Axes.OPENGL), T);
  // Unity: a camera at (1, 2, 3) that looks along z, with y up, looks along −z of the right-handed frame from (1, 2, −3)
  const unity = toOpenCV(pose([0, 0, 0], [1, 2, 3]), Axes.UNITY);
  near(unity, [[1, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1, -3], [0, 0, 0, 1]]);
  // turned to the right by a quarter, it looks along x
  const right = toOpenCV(pose([0, Math.PI / 2, 0], [0, 0, 0]), Axes.UNITY);
  near([right.slice(0, 3).map((row) => row[2])], [[1, 0, 0]]);
  for (const bad of [[1, 2], COLUMNS(multiply(T, [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]))])
    assert.throws(() => toOpenCV(bad, Axes.OPENGL), RangeError);
  assert.throws(() => toOpenCV(T, "sideways"), /sideways/);
});

test("a picture that is cropped, scaled or turned shows the same rays", () => {
  const sensor = { width: 1920, height: 1440, fx: 1500, fy: 1490, cx: 961, cy: 715 };
  const part = camera(sensor, { crop: { x: 240, y: 180, width: 1440, height: 1080 }, width: 720, height: 540 });
  const ray = ({ fx, fy, cx, cy }, u, v) => [(u - cx) / fx, (v - cy) / fy];
  near([ray(part, 99.5, 49.5)], [ray(sensor, 240 + 199.5, 180 + 99.5)]);
  assert.deepEqual([part.width, part.height], [720, 540]);
  // clockwise by a quarter: what was at the top is at the right
  const [up, here] = [[0, -1, 0], inverse(turned(IDENTITY, 1))];
  near([here.slice(0, 3).map((row) => row[0] * up[0] + row[1] * up[1] + row[2] * up[2])], [[1, 0, 0]]);
  near(turned(turned(turned(turned(IDENTITY, 1), 1), 1), 1), IDENTITY);
  near(turned(IDENTITY, -1), turned(IDENTITY, 3));
});

test("the intrinsics of a raw picture follow from WebXR's projection matrix", () => {
  const [width, height, fx, fy, cx, cy, near, far] = [640, 480, 500, 510, 330.5, 231.5, 0.1, 100];
  // OpenGL's frustum through the edges of the picture, whose pixel (0, 0) is the centre of the top-left one
  const [left, right] = [-0.5 - cx, width - 0.5 - cx].map((u) => (u / fx) * near);
  const [top, bottom] = [-0.5 - cy, height - 0.5 - cy].map((v) => (-v / fy) * near);
  const rows = [
    [(2 * near) / (right - left), 0, (right + left) / (right - left), 0],
    [0, (2 * near) / (top - bottom), (top + bottom) / (top - bottom), 0],
    [0, 0, -(far + near) / (far - near), (-2 * far * near) / (far - near)],
    [0, 0, -1, 0],
  ];
  const found = cameraOfProjection(COLUMNS(rows), width, height);
  near_(found, { width, height, fx, fy, cx, cy });
});

const near_ = (found, expected) =>
  Object.entries(expected).forEach(([name, value]) => assert.ok(Math.abs(found[name] - value) < 1e-9, `${name}: ${found[name]}`));

/** A walk of a session whose place is known, and answers with errors of a sigma; some are of another place. */
async function walked(seed, { wrong = () => false, recognized = 0.95, sigmaM = 0.01, ...options } = {}) {
  const random = normal(seed);
  const T_map_session = pose([0.1, -1.2, 0.4], [3, -2, 1]);
  let nowMs = 0;
  const events = [];
  let truth = IDENTITY;
  const covariance = IDENTITY.concat(IDENTITY).slice(0, 6).map((_, i) => Array.from({ length: 6 }, (_, j) => (i === j) * (i < 3 ? sigmaM ** 2 : 0.3 ** 2)));
  const locate = async () => {
    const off = pose([0, 1, 2].map(() => 0.005 * random()), [0, 1, 2].map(() => sigmaM * random()));
    const T = multiply(multiply(T_map_session, truth), off);
    if (wrong(nowMs)) T[0][3] += 4;
    return { localized: true, recognized, covariance, pose: { T_map_camera: T } };
  };
  const session = new MapSession(locate, {
    ...options,
    axes: Axes.OPENCV,
    now: () => nowMs,
    onLocalized: () => events.push("localized"),
    onLost: () => events.push("lost"),
  });
  const errors = [];
  for (; nowMs < 40_000; nowMs += 100) {
    truth = pose([0, nowMs / 9000, 0], [Math.sin(nowMs / 5000), 0.2, Math.cos(nowMs / 5000)]);
    await session.offer({ pose: truth, picture: null, camera: {} });
    const said = session.inMap(truth);
    const T = multiply(T_map_session, truth);
    if (said) errors.push(Math.hypot(...[0, 1, 2].map((i) => said[i][3] - T[i][3])));
  }
  return { session, errors, events, T_map_session };
}

test("a session is placed to two centimetres, ten times of ten", async () => {
  for (let seed = 0; seed < 10; seed++) {
    const { errors } = await walked(seed);
    assert.ok(errors.length > 390);
    assert.ok(Math.max(...errors.slice(50)) < 0.02, `seed ${seed}: ${Math.max(...errors.slice(50))}`);
  }
});

test("single wrong answers change nothing, and a doubtful one begins nothing", async () => {
  const { errors } = await walked(3, { wrong: (ms) => ms > 9000 && ms < 10_500 });
  assert.ok(Math.max(...errors.slice(50)) < 0.03);
  const doubtful = await walked(4, { recognized: 0.65 });
  assert.ok(doubtful.errors.length < 400); // the first frames wait for a second answer
  assert.ok(Math.max(...doubtful.errors) < 0.05);
});

test("a session that jumped is found again, and one that nobody confirms is lost", async () => {
  const { session, events, T_map_session } = await walked(5, { wrong: (ms) => ms > 15_000 });
  assert.ok(Math.abs(session.T_map_session[0][3] - T_map_session[0][3] - 4) < 0.05);
  assert.equal(events.includes("lost"), false);
  const alone = await walked(6, { wrong: (ms) => ms > 5000 && Math.floor(ms / 1500) % 2 === 0, lostAfterMs: 1000 });
  assert.ok(alone.events.includes("lost"));
});

test("points of the map are drawn in the session's axes", async () => {
  const { session, T_map_session } = await walked(7);
  const point = [1, 2, 0.5];
  const T = inverse(T_map_session);
  const expected = [0, 1, 2].map((i) => T[i][0] + T[i][1] * 2 + T[i][2] * 0.5 + T[i][3]);
  near([session.toSession(point)], [expected], 0.03);
  session.axes = Axes.UNITY;
  near([session.toSession(point)], [[expected[0], expected[1], -expected[2]]], 0.03);
  assert.equal(new MapSession(async () => {}).toSession(point), null);
});

test("errors have a code, and say whether to try again", async () => {
  const answers = [
    async () => new Response(JSON.stringify({ code: "unknown_map", message: "No.", hint: "Ask." }), { status: 404 }),
    async () => new Response("<html>", { status: 503 }),
    async () => {
      throw new TypeError("fetch failed");
    },
  ];
  const found = [];
  for (const fetch of answers) {
    const rholoc = new Client("http://localhost:1/", { fetch });
    await rholoc.localize("hall", new Uint8Array(3)).catch((error) => found.push(error));
  }
  assert.ok(found.every((error) => error instanceof RholocError));
  assert.deepEqual(found.map(({ code, status, passes }) => [code, status, passes]), [
    ["unknown_map", 404, false],
    ["error", 503, true],
    ["unreachable", 0, true],
  ]);
  assert.equal(found[0].message, "No. Ask.");
});

test("any route is asked for, with the key there is by then; a refused key is asked for once more", async () => {
  const asked = [];
  let key = null;
  const fetch = async (address, { method, headers, body }) => {
    asked.push([method, address.href, headers, body]);
    if (!headers.Authorization) return Response.json({ code: "no_key", message: "A key is missing." }, { status: 401 });
    return method === "DELETE" ? new Response(null, { status: 204 }) : Response.json({ done: true });
  };
  const onRefused = async ({ summary }) => {
    key = summary.length;
    return true;
  };
  const rholoc = new Client("https://rholoc.example/under", { fetch, key: () => key, onRefused, translate: (text) => `„${text}“` });
  assert.deepEqual(await rholoc.call("PUT", path`v1/sites/${"a b/c"}`, { body: { maps: [] }, query: { level: "", at: 2 } }), { done: true });
  assert.equal(await rholoc.call("DELETE", "v1/maps/hall"), null);
  assert.deepEqual(asked.map(([method, where]) => [method, where]), [
    ["PUT", "https://rholoc.example/under/v1/sites/a%20b%2Fc?at=2"],
    ["PUT", "https://rholoc.example/under/v1/sites/a%20b%2Fc?at=2"],
    ["DELETE", "https://rholoc.example/under/v1/maps/hall"],
  ]);
  assert.deepEqual(asked[1].slice(2), [{ "Content-Type": "application/json", Authorization: "Bearer 19" }, '{"maps":[]}']);
  key = null;
  const stubborn = new Client("https://rholoc.example", { fetch, key: () => key });
  await assert.rejects(stubborn.get("v1/maps"), { code: "no_key", status: 401, passes: false });
});

test("a job is followed through a stream that breaks, in pieces however they come", async () => {
  const events = (...jobs) => jobs.map((job) => `event: job\r\ndata: ${JSON.stringify(job)}\r\n\r\n`).join("");
  const broken = new ReadableStream({
    start(controller) {
      const bytes = new TextEncoder().encode(events({ state: "queued", message: "ö" }));
      for (let i = 0; i < bytes.length; i += 7) controller.enqueue(bytes.slice(i, i + 7));
    },
    pull: (controller) => controller.error(new TypeError("network error")),
  });
  const answers = [broken, events({ state: "running" }, { state: "published" }, { state: "never seen" })];
  const heard = [];
  const rholoc = new Client("http://localhost:1", { fetch: async () => new Response(answers.shift()) });
  const onLost = ({ code }) => heard.push(code);
  const last = await rholoc.waitForJob("j1", { onChange: ({ state }) => heard.push(state), onLost });
  assert.deepEqual(last, { state: "published" });
  assert.deepEqual(heard, ["queued", "unreachable", "running", "published"]);
  const gone = async () => Response.json({ code: "unknown_job", message: "No." }, { status: 404 });
  await assert.rejects(new Client("http://localhost:1", { fetch: gone }).waitForJob("j1"), { code: "unknown_job" });
});

test("a track is begun, answers each frame, and says what broke it off", async (context) => {
  const sockets = [];
  class Socket extends EventTarget {
    static OPEN = 1;
    sent = [];
    readyState = Socket.OPEN;
    constructor(address, protocols) {
      super();
      sockets.push(Object.assign(this, { address, protocols }));
      queueMicrotask(() => this.dispatchEvent(new Event("open")));
    }
    say = (data) => this.dispatchEvent(Object.assign(new Event("message"), { data: JSON.stringify(data) }));
    send(data) {
      this.sent.push(data);
      if (typeof data !== "string") this.say({ type: "tracked", answer: null, status: "tracking" });
      else if (JSON.parse(data).type === "begin") this.say({ type: "begun" });
    }
    close() {
      this.readyState = 3;
      this.dispatchEvent(new Event("close"));
    }
  }
  const real = globalThis.WebSocket;
  globalThis.WebSocket = /** @type {any} */ (Socket);
  context.after(() => (globalThis.WebSocket = real));
  const heard = [];
  const rholoc = new Client("https://rholoc.example", { key: "k1" });
  const stream = await rholoc.track("hall", { dof: "auto" }, ({ status }) => heard.push(status));
  const [socket] = sockets;
  assert.equal(socket.address.href, "wss://rholoc.example/v1/maps/hall/track");
  assert.deepEqual(socket.protocols, ["rholoc.track.1", "rholoc.key.k1"]);
  await stream.frame(0.5, new Uint8Array(3));
  assert.deepEqual(socket.sent.slice(0, 2).map(JSON.parse), [
    { type: "begin", dof: "auto" },
    { type: "frame", time_s: 0.5, picture: true },
  ]);
  assert.deepEqual(heard, ["tracking"]);
  socket.send = () => socket.say({ type: "error", code: "not_an_image", message: "No picture." });
  await assert.rejects(stream.frame(0.6, new Uint8Array(3)), { name: "RholocError", code: "not_an_image" });
  socket.close();
  await assert.rejects(stream.frame(0.7, new Uint8Array(3)), { code: "unreachable", message: "The connection broke off." });
});

test("a track that is ended before it is connected is closed once it is, without a word", async (context) => {
  const sockets = [];
  class Socket extends EventTarget {
    static CONNECTING = 0;
    readyState = Socket.CONNECTING;
    did = [];
    constructor() {
      super();
      sockets.push(this);
    }
    send = () => this.did.push("sent");
    close = () => this.did.push(this.readyState === Socket.CONNECTING ? "broken off" : "closed");
  }
  const real = globalThis.WebSocket;
  globalThis.WebSocket = /** @type {any} */ (Socket);
  context.after(() => (globalThis.WebSocket = real));
  const rholoc = new Client("https://rholoc.example");
  const stopping = new AbortController();
  const track = rholoc.track("hall", {}, () => {}, stopping);
  stopping.abort();
  await assert.rejects(track, { code: "unreachable" });
  const [socket] = sockets;
  assert.deepEqual(socket.did, []);
  socket.readyState = 1;
  socket.dispatchEvent(new Event("open"));
  assert.deepEqual(socket.did, ["closed"]);
  await assert.rejects(rholoc.track("hall", {}, () => {}, stopping), { code: "unreachable" });
  assert.equal(sockets.length, 1);
});

test("an upload goes on from the last byte that the server has", async () => {
  const server = new Uint8Array(5 * 2 ** 20);
  let [offset, broken] = [0, 0];
  const fetch = async (address, { method, headers, body }) => {
    const standing = () => ({ "Upload-Offset": String(offset), ...(offset === server.length ? { "Rholoc-Job": "j1" } : {}) });
    if (method === "POST") return new Response(null, { status: 201, headers: { Location: "/v1/uploads/u1" } });
    if (method === "HEAD") return new Response(null, { headers: standing() });
    assert.equal(Number(headers["Upload-Offset"]), offset);
    if (offset > 2 ** 21 && broken++ < 1) throw new TypeError("connection lost");
    const piece = new Uint8Array(await body.arrayBuffer());
    server.set(piece, offset);
    offset += piece.length;
    return new Response(null, { status: 204, headers: standing() });
  };
  const sent = Uint8Array.from(server, (_, i) => i % 251);
  const heard = [];
  const rholoc = new Client("http://localhost:1", { fetch });
  const job = await rholoc.upload(new Blob([sent]), { map: "hall", onProgress: (bytes) => heard.push(bytes) });
  assert.equal(job, "j1");
  assert.deepEqual(server, sent);
  assert.equal(broken, 2);
  assert.equal(heard.at(-1), sent.length);
});

test("an upload that the service lost is begun anew, and one that it refuses is not tried again", async () => {
  const [locations, waited] = [[], []];
  const fetch = async (address, { method }) => {
    if (address.pathname.endsWith("old")) return Response.json({ code: "unknown_upload", message: "Gone." }, { status: 404 });
    if (method === "HEAD") return new Response(null, { headers: { "Upload-Offset": "3", "Rholoc-Job": "j2" } });
    return new Response(null, { status: 201, headers: { Location: "/v1/recordings/new" } });
  };
  const rholoc = new Client("http://localhost:1", { fetch });
  const options = { map: "hall", location: "http://localhost:1/v1/recordings/old" };
  const onLocation = (location) => locations.push(location);
  const onWaiting = ({ status }) => waited.push(status);
  assert.equal(await rholoc.upload(new Blob(["abc"]), { ...options, onLocation, onWaiting }), "j2");
  assert.deepEqual([locations, waited], [[null, "http://localhost:1/v1/recordings/new"], [404]]);
  const full = async () => Response.json({ code: "quota", message: "Full." }, { status: 507 });
  const refusing = new Client("http://localhost:1", { fetch: full });
  await assert.rejects(refusing.upload(new Blob(["abc"]), { map: "hall", tries: Infinity }), { code: "quota" });
});

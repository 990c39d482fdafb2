// A visitor's page: the camera looks around, a dot on the plan says where one is, an arrow where to go.

import { drawFloor, endsOf, placedPlan } from "../console/floor.js";
import { frameOf } from "../console/frame_sources.js";
import { readRoom } from "../console/scene_data.js";
import { openCamera } from "../record/camera.js";
import { path, rholoc, takeKeyOfLink } from "../shared/api.js";
import { fill, h } from "../shared/dom.js";
import { decimal, t, translatePage } from "../shared/text.js";
import { Belief } from "./belief.js";
import { groundOf, guidance, Step, wayBetween } from "./way.js";

const EVERY_MS = 1000; // at most one request in
const SVG = "http://www.w3.org/2000/svg";
const ARROW = "M32 4 L56 40 L38 34 L38 60 L26 60 L26 34 L8 40 Z";

const site = decodeURIComponent(location.pathname.split("/").pop() ?? "");

class Visit {
  constructor(main) {
    this.belief = new Belief();
    this.turned = 0;
    this.plans = new Map(); // of the rooms' maps
    this.said = h("p", { class: "here-said", role: "status" }, t`Point the camera around you.`);
    this.video = h("video", { muted: true, playsinline: true, autoplay: true });
    this.sent = h("canvas");
    this.arrow = arrow();
    this.plan = h("canvas", { class: "here-plan", role: "img", "aria-label": t`Plan of the floor` });
    this.target = h("select", { onchange: () => this.show() });
    this.begin = h("button", { type: "button", class: "primary", onclick: () => this.start() }, t`Show me where I am`);
    fill(
      main,
      h("h1", {}, site),
      h("label", { class: "here-choice" }, t`Lead me to`, this.target),
      this.said,
      h("div", { class: "here-camera" }, this.video, this.arrow, this.begin),
      this.plan,
      h("p", { class: "small muted" }, t`Pictures go to this site's own server, and are not kept.`),
    );
    new ResizeObserver(() => this.show()).observe(this.plan);
  }

  async load() {
    this.here = await rholoc.get(path`v1/here/${site}`);
    fill(
      this.target,
      h("option", { value: "" }, t`nowhere`),
      this.here.points.map(({ name }, i) => h("option", { value: i }, name)),
    );
    this.floors = new Map();
    for (const room of this.here.rooms) this.floors.set(room.floor, [...(this.floors.get(room.floor) ?? []), room]);
    this.show();
    for (const { map, room, T_site_map: T } of this.here.rooms) {
      if (!room) continue;
      this.plans.set(map, placedPlan(readRoom(await rholoc.bytes(path`v1/here/${site}/rooms/${map}`)), T));
      this.show();
    }
  }

  async start() {
    this.begin.hidden = true;
    try {
      await askForMotion();
      addEventListener("deviceorientation", ({ alpha }) => alpha !== null && this.turn((alpha * Math.PI) / 180));
      this.video.srcObject = await openCamera();
      await this.video.play();
    } catch (error) {
      this.begin.hidden = false;
      this.said.textContent = error.message;
      return;
    }
    setInterval(() => this.show(), 200);
    this.look();
  }

  /** Hear the phone's direction [rad], which only changes matter of. */
  turn(alpha) {
    const by = alpha - (this.alpha ?? alpha);
    this.turned += Math.atan2(Math.sin(by), Math.cos(by));
    this.alpha = alpha;
    this.belief.turn(this.turned);
  }

  /** Ask where the camera is, again and again. */
  async look() {
    const began = performance.now();
    if (!document.hidden && this.video.videoWidth) {
      try {
        const turned = this.turned;
        const answer = await rholoc.call("POST", path`v1/here/${site}/localize`, {
          body: (await frameOf(this.video, this.sent)).blob,
          query: { intrinsics: "unknown" },
        });
        this.belief.hear(answer, began / 1000, turned);
        this.why = answer.localized ? null : answer.message;
      } catch (error) {
        this.why = error.summary ?? error.message;
      }
      this.show();
    }
    setTimeout(() => this.look(), Math.max(0, EVERY_MS - (performance.now() - began)));
  }

  show() {
    if (!this.here) return;
    const now = this.belief.at(performance.now() / 1000);
    const goal = this.here.points[this.target.value] ?? null;
    const floor = now?.floor ?? goal?.floor ?? this.here.rooms[0]?.floor;
    const rooms = this.floors.get(floor) ?? [];
    const walks = rooms.flatMap(({ walked }) => walked);
    const way = now && goal && goal.floor === now.floor ? this.way(floor, walks, now.position, goal.position) : null;
    const step = way && guidance(way, now.direction);
    this.arrow.toggleAttribute("hidden", !step || step.step === Step.ARRIVED);
    if (step) this.arrow.style.transform = `rotate(${(-step.bearing * 180) / Math.PI}deg)`;
    if (this.begin.hidden) this.said.textContent = this.sentence(now, goal, way, step);
    const plans = rooms.map(({ map }) => this.plans.get(map)).filter(Boolean);
    const ends = endsOf(plans, [...walks.flat(), ...this.here.points.map(({ position }) => position)]);
    drawFloor(this.plan, plans, walks, ends, (context, place, scale, colour) =>
      this.drawOver({ context, place, scale, colour }, floor, now, way),
    );
  }

  way(floor, walks, from, to) {
    if (this.ground?.floor !== floor) this.ground = { floor, grid: groundOf(walks) };
    return this.ground.grid && wayBetween(this.ground.grid, from, to);
  }

  /** One sentence on where the visitor is, or what to do. */
  sentence(now, goal, way, step) {
    if (!now) return this.why ?? t`I do not know where you are. Point the camera around you.`;
    if (!goal) return t`You are here, give or take ${decimal(now.sigma, 1)} m.`;
    if (goal.floor !== now.floor) return t`${goal.name} is on another floor: ${goal.floor}.`;
    if (!way) return t`No walk leads from here to ${goal.name}.`;
    if (step.step === Step.ARRIVED) return t`You are there: ${goal.name}.`;
    if (step.step === Step.TURN) return step.bearing > 0 ? t`Turn left.` : t`Turn right.`;
    const metres = decimal(Math.max(1, Math.round(step.metres)));
    if (step.turn > 0) return t`${metres} m, then left`;
    if (step.turn < 0) return t`${metres} m, then right`;
    return t`${metres} m straight on`;
  }

  drawOver({ context, place, scale, colour }, floor, now, way) {
    if (way) {
      context.strokeStyle = colour("--accent");
      context.lineWidth = 5;
      context.lineJoin = "round";
      context.beginPath();
      for (const point of way) context.lineTo(...place(point));
      context.stroke();
    }
    context.font = "600 14px system-ui, sans-serif";
    for (const { name, position, floor: on } of this.here.points) {
      if (on !== floor) continue;
      const [x, y] = place(position);
      context.fillStyle = colour("--bad");
      context.fillRect(x - 4, y - 4, 8, 8);
      context.lineWidth = 3;
      context.strokeStyle = colour("--surface");
      context.strokeText(name, x + 8, y + 5);
      context.fillStyle = colour("--ink");
      context.fillText(name, x + 8, y + 5);
    }
    if (now) drawDot(context, place(now.position), now, scale, colour("--accent"));
  }
}

/** A dot, a disk of two standard deviations around it, and a wedge where the camera looks. */
function drawDot(context, [x, y], { sigma, direction }, scale, accent) {
  context.fillStyle = accent;
  context.globalAlpha = 0.2;
  context.beginPath();
  context.arc(x, y, 2 * sigma * scale, 0, 2 * Math.PI);
  context.fill();
  context.globalAlpha = 0.5;
  context.beginPath();
  context.moveTo(x, y);
  context.arc(x, y, 28, -direction - 0.45, -direction + 0.45);
  context.fill();
  context.globalAlpha = 1;
  context.beginPath();
  context.arc(x, y, 8, 0, 2 * Math.PI);
  context.fill();
}

function arrow() {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 64 64");
  svg.setAttribute("class", "here-arrow");
  svg.setAttribute("aria-hidden", "true");
  svg.setAttribute("hidden", "");
  const shape = document.createElementNS(SVG, "path");
  shape.setAttribute("d", ARROW);
  svg.append(shape);
  return svg;
}

/** iPhones only tell pages of motion that asked. */
async function askForMotion() {
  const motion = /** @type {any} */ (globalThis.DeviceOrientationEvent);
  if (motion?.requestPermission) await motion.requestPermission();
}

takeKeyOfLink(true);
translatePage();
document.title = `${site} – rholoc`;
const visit = new Visit(document.getElementById("content"));
visit.load().catch((error) => (visit.said.textContent = error.message));

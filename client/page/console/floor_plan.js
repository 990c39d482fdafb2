// Floor plans: pictures, and GeoJSON, whose lines are brought into metres.

import { path, rholoc } from "../shared/api.js";
import { t } from "../shared/text.js";
import { planOf, surfaces } from "./room.js";
import { readRoom } from "./scene_data.js";

export const GEOJSON = "application/geo+json";
const [EQUATOR_M, ECCENTRICITY_2] = [6378137, 0.00669437999014]; // of WGS 84
const MOST_LINES = 20_000;

/**
 * What a file holds: `{image, width, height}` of a picture, in pixels; or `{lines, width, height}` of GeoJSON, lists of
 * [x, y] in metres from its south-western corner.
 */
export async function readPlan(file, name = file.name) {
  if (/json$/i.test(file.type) || /\.(geo)?json$/i.test(name)) return planOfGeoJson(await file.text());
  try {
    const image = await createImageBitmap(file);
    return { image, width: image.width, height: image.height };
  } catch {
    throw new Error(t`${name} is neither a picture nor GeoJSON.`);
  }
}

/** What lies under a map seen from above: its floor plan, else its room's surfaces, else nothing. */
export async function planUnder(map, signal) {
  if (map.plan) return keptPlan(map, signal);
  if (!map.room) return null;
  return planOf(surfaces(readRoom(await rholoc.bytes(path`v1/maps/${map.name}/room`, { signal }))));
}

/** The floor plan that a map keeps, as a `PlanView` draws it. */
export async function keptPlan({ name, plan }, signal) {
  const response = await rholoc.request("GET", path`v1/maps/${name}/plan`, { signal });
  const { image, lines } = await readPlan(await response.blob(), t`The floor plan`);
  return { image, lines, corner: plan.corner, turn: (plan.turn_deg * Math.PI) / 180, perPixel: plan.m_per_unit };
}

/** The lines of a GeoJSON text. */
export function planOfGeoJson(text) {
  let whole;
  try {
    whole = JSON.parse(text);
  } catch {
    throw new Error(t`The file is not JSON.`);
  }
  const lines = linesOf(whole).filter((line) => line.length > 1);
  const points = lines.flat();
  if (!points.length || points.some((point) => !point.slice(0, 2).every(Number.isFinite)))
    throw new Error(t`The GeoJSON has no lines or areas.`);
  const ends = (axis) => [axis].map((i) => points.map((point) => point[i])).map((v) => [least(v), greatest(v)])[0];
  const [[west, east], [south, north]] = [ends(0), ends(1)];
  if (Math.max(-west, east) > 180 || Math.max(-south, north) > 90)
    throw new Error(t`GeoJSON has degrees: longitude and latitude.`);
  const radians = Math.PI / 180;
  const middle = ((south + north) / 2) * radians;
  const w = 1 - ECCENTRICITY_2 * Math.sin(middle) ** 2; // the ellipsoid's radii of curvature: of the meridian, across it
  const [perLatitude, perLongitude] = [
    ((EQUATOR_M * (1 - ECCENTRICITY_2)) / w ** 1.5) * radians,
    (EQUATOR_M / Math.sqrt(w)) * radians * Math.cos(middle),
  ];
  const metres = lines.map((line) => line.map(([x, y]) => [(x - west) * perLongitude, (y - south) * perLatitude]));
  return { lines: metres, width: (east - west) * perLongitude, height: (north - south) * perLatitude };
}

const least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
const greatest = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);

function linesOf(node) {
  if (!node || typeof node !== "object") return [];
  const { type, coordinates } = node;
  const found = {
    FeatureCollection: () => (node.features ?? []).flatMap(linesOf),
    Feature: () => linesOf(node.geometry),
    GeometryCollection: () => (node.geometries ?? []).flatMap(linesOf),
    LineString: () => [coordinates],
    MultiLineString: () => coordinates,
    Polygon: () => coordinates,
    MultiPolygon: () => coordinates.flat(),
  }[type]?.();
  return (found ?? []).filter((line) => Array.isArray(line) && line.every(Array.isArray)).slice(0, MOST_LINES);
}

/** How long a pixel of a plan is, in metres, by two points of it and of a map that is metric. */
export function metresPerPixel([a, b], [p, q]) {
  const onMap = Math.hypot(b[0] - a[0], b[1] - a[1]);
  const onPlan = Math.hypot(q[0] - p[0], q[1] - p[1]);
  return onPlan > 0 ? onMap / onPlan : 0;
}

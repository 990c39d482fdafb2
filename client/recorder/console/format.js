// Figures and times for people.

export { length } from "./scene.js";

const UNITS = ["bytes", "kB", "MB", "GB"];
const RELATIVE = new Intl.RelativeTimeFormat("en", { numeric: "auto" });
const SPANS = [
  ["day", 86400],
  ["hour", 3600],
  ["minute", 60],
  ["second", 1],
];

/** 416937 → "417 kB" */
export function bytes(count) {
  const power = Math.min(UNITS.length - 1, count < 1000 ? 0 : Math.floor(Math.log10(count) / 3));
  return `${Number((count / 1000 ** power).toPrecision(3))} ${UNITS[power]}`;
}

/** A count with thousands apart. */
export const count = (value) => value.toLocaleString("en");

/** Seconds since the epoch → "3 minutes ago" */
export function ago(seconds) {
  const since = seconds - Date.now() / 1000;
  const [unit, span] = SPANS.find(([, one]) => Math.abs(since) >= one) ?? SPANS.at(-1);
  return RELATIVE.format(Math.trunc(since / span), unit);
}

/** An ISO time, or seconds since the epoch → local date and time. */
export function when(time) {
  const date = new Date(typeof time === "number" ? time * 1000 : time);
  return Number.isNaN(date.getTime())
    ? String(time)
    : date.toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" });
}

/** Seconds → "2 min 5 s" */
export function duration(seconds) {
  const whole = Math.round(seconds);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}

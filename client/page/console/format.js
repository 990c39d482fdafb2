// Figures and times for people.

import { language, t } from "../shared/text.js";

const UNITS = ["bytes", "kB", "MB", "GB"];
const RELATIVE = new Intl.RelativeTimeFormat(language, { numeric: "auto" });
/** @type {[Intl.RelativeTimeFormatUnit, number][]} */
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
export const count = (value) => value.toLocaleString(language);

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
    : date.toLocaleString(language === "de" ? "de" : "en-GB", { dateStyle: "medium", timeStyle: "short" });
}

/** Seconds → "2 min 5 s" */
export function duration(seconds) {
  const whole = Math.round(seconds);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}

/** A length for people: centimetres below a metre; bare units where the map is not metric. */
export function length(value, metric = true) {
  if (!metric) return value.toPrecision(2) + t` units`;
  return value < 1 ? `${(100 * value).toFixed(value < 0.1 ? 1 : 0)} cm` : `${value.toFixed(2)} m`;
}

/** The files of a recording in a few words. */
export function fileNames({ files }) {
  const [first, ...more] = files;
  return more.length ? t`${first} and ${more.length} more` : first;
}

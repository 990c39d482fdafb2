// A job in words: what it is doing, and how long it will still take.

import { heard, t } from "./text.js";

/** The stages of a job that makes a map, in order. */
export const STAGES = {
  received: t`Received`,
  read: t`Reading the recording`,
  keyframes: t`Choosing pictures`,
  features: t`Finding what can be recognised`,
  poses: t`Finding where each picture was taken`,
  observations: t`Comparing the pictures`,
  densities: t`Learning what is seen from where`,
  report: t`Testing the map`,
  published: t`Published`,
};

const MIN_PROGRESS = 0.05; // before that, the time spent says little about the rest

/** What a job is doing, in one line that is never empty. */
export function doing({ state = "", stage, message, error }) {
  const isOld = message === stage || (state === "running" && message.startsWith("waiting for ")); // its worker has begun
  return heard(error?.message ?? (isOld ? "" : message)) || (STAGES[stage] ?? t`Comparing the maps`);
}

/** How long a running job will still take [s], by the time since it started; null while that says too little. */
export function secondsLeft({ state, started, progress }, now = Date.now() / 1000) {
  const spent = now - started;
  if (state !== "running" || !started || spent <= 0 || progress < MIN_PROGRESS) return null;
  return (spent * (1 - progress)) / progress;
}

/** The same in words; empty where it is not known. */
export function timeLeft(job, now) {
  const seconds = secondsLeft(job, now);
  if (seconds === null) return "";
  if (seconds < 50) return t`less than a minute left`;
  const minutes = Math.round(seconds / 60);
  if (minutes < 2) return t`about a minute left`;
  return minutes < 100 ? t`about ${minutes} minutes left` : t`about ${Math.round(minutes / 60)} hours left`;
}

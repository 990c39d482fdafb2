// A mapping job, followed until it ends.

import { ApiError, call, get, passes, path } from "../shared/api.js";
import { events } from "../shared/events.js";

const ENDED = new Set(["published", "failed", "cancelled"]);
const PAUSE_MS = 1500;

/**
 * Hear of every change of a job; resolves to the job as it ended. Its events are listened to where the server sends
 * them, else it is asked for every now and then; while there is no connection, this waits for one, and `lost` hears why.
 * @throws {ApiError} when there is no such job; AbortError.
 */
export async function followJob(id, hear, signal, lost = (_error) => {}) {
  for (;;) {
    try {
      for await (const job of jobEvents(id, signal)) {
        hear(job);
        if (ENDED.has(job.state)) return job;
      }
      const job = await get(path`v1/jobs/${id}`, { signal });
      hear(job);
      if (ENDED.has(job.state)) return job;
    } catch (error) {
      if (!(error instanceof TypeError || (error instanceof ApiError && passes(error)))) throw error;
      if (error instanceof ApiError) lost(error);
    }
    await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
    signal?.throwIfAborted();
  }
}

/** End a job; whoever follows it hears of that. */
export const cancelJob = (id) => call("DELETE", path`v1/jobs/${id}`);

/** What the server says of a job as it changes, until the connection ends. */
async function* jobEvents(id, signal) {
  try {
    yield* events(path`v1/jobs/${id}/events`, signal);
  } catch (error) {
    if (error.code !== "unknown_route") throw error;
  }
}

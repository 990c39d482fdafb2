// Compares pictures with earlier ones, beside the page: `{grey, width, height, time}` → `{since, views}`.

import { featuresOf, PlaceMemory } from "./place_memory.js";

const memory = new PlaceMemory();

addEventListener("message", ({ data: { grey, width, height, time } }) => {
  const found = memory.see(featuresOf(grey, width, height), time);
  postMessage({ since: found?.since ?? null, views: memory.count });
});

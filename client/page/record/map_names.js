// The maps that the server has, as far as it says so without being asked for a key.

import { authorization, url } from "../shared/api.js";

/** Their names; null where the server does not answer, or wants a key. */
export async function mapNames() {
  try {
    const response = await fetch(url("v1/maps"), { credentials: "omit", headers: authorization() });
    return response.ok ? (await response.json()).maps.map((map) => map.name) : null;
  } catch {
    return null;
  }
}

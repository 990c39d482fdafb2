// The maps that the server has, as far as it says so without being asked for a key.

import { unasking } from "../shared/api.js";

/** Their names; null where the server does not answer, or wants a key. */
export const mapNames = () =>
  unasking.maps().then(
    (maps) => maps.map(({ name }) => name),
    () => null,
  );

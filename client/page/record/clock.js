// One clock for everything: that of performance.now(), in seconds.

const AGREEMENT_S = 0.004; // of a recorded and a seen time that are the same frame's
const EARLIEST_S = -0.1; // when the first recorded frame can have been taken, after the recorder was told to start
const LATEST_S = 1;
const FIRST_CANDIDATES = 5; // of the recorded frames; the first may not have been seen
const NEARLY = 0.98; // of the best: shifts by whole frames fit a steady camera as well

/**
 * When the recorded frames were taken, on the clock.
 *
 * The recorder writes each frame's time after its first, and the page sees when most of the frames were taken. The shift
 * between both is the one under which the most frames agree; among equals, that which has the first frame taken soonest
 * after the start.
 * @param {number[]} recorded the container's times, the first being 0.
 * @param {number[]} seen the times of requestVideoFrameCallback on the clock, increasing; more, or fewer.
 * @param {number} started when the recorder was told to start, on the clock.
 */
export function clockTimes(recorded, seen, started) {
  const offset = bestOffset(recorded, seen, started);
  let row = 0;
  return recorded.map((time) => {
    row = nearest(seen, time + offset, row);
    const near = seen[row];
    return Math.abs(near - time - offset) <= AGREEMENT_S ? near : time + offset;
  });
}

function bestOffset(recorded, seen, started) {
  const candidates = recorded
    .slice(0, FIRST_CANDIDATES)
    .flatMap((time) => seen.map((moment) => moment - time))
    .filter((offset) => offset - started >= EARLIEST_S && offset - started <= LATEST_S)
    .map((offset) => ({ offset, agreeing: agreeing(recorded, seen, offset) }));
  const most = Math.max(...candidates.map((candidate) => candidate.agreeing));
  const delay = ({ offset }) => (offset >= started ? offset - started : LATEST_S - (offset - started));
  const good = candidates
    .filter((candidate) => candidate.agreeing >= NEARLY * most)
    .sort((a, b) => delay(a) - delay(b));
  return good.length ? good[0].offset : started;
}

function agreeing(recorded, seen, offset) {
  let [count, row] = [0, 0];
  for (const time of recorded) {
    row = nearest(seen, time + offset, row);
    if (Math.abs(seen[row] - time - offset) <= AGREEMENT_S) count++;
  }
  return count;
}

/** The row of the increasing `times` that is nearest to `wanted`, from `row` on. */
function nearest(times, wanted, row) {
  while (row + 1 < times.length && Math.abs(times[row + 1] - wanted) <= Math.abs(times[row] - wanted)) row++;
  return row;
}

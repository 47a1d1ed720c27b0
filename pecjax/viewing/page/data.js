// The page's data: a JSON header and the arrays that it lists, compressed by gzip and written in base64.
"use strict";

const ARRAY_TYPES = { float32: Float32Array, uint8: Uint8Array };

async function readData(text) {
  const packed = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = await new Response(stream).arrayBuffer();
  const headerLength = new DataView(bytes).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, headerLength)));
  for (const about of header.arrays) {
    header[about.name] = new ARRAY_TYPES[about.type](bytes, 4 + headerLength + about.offset, about.size);
  }
  for (const flight of header.flights) {
    flight.positions = header.poses.subarray(7 * flight.first, 7 * (flight.first + flight.length + 1));
    flight.distance = distancesToGoal(flight);
    flight.speed = speeds(flight, header.period);
    [flight.roll, flight.pitch] = tilts(flight);
  }
  return header;
}

// Level distance to the goal, or to the waypoint as long as it has not been passed, in m.
function distancesToGoal(flight) {
  const distances = new Float32Array(flight.length + 1);
  let target = flight.waypoint ?? flight.goal;
  for (let step = 0; step <= flight.length; step++) {
    const [x, y] = flight.positions.subarray(7 * step, 7 * step + 2);
    distances[step] = Math.hypot(target[0] - x, target[1] - y);
    if (distances[step] < flight.goalRadius) target = flight.goal;
  }
  return distances;
}

// Mean level speed over each step, in m/s.
function speeds(flight, period) {
  const found = new Float32Array(flight.length);
  for (let step = 0; step < flight.length; step++) {
    const [from, to] = [flight.positions.subarray(7 * step), flight.positions.subarray(7 * (step + 1))];
    found[step] = Math.hypot(to[0] - from[0], to[1] - from[1]) / period;
  }
  return found;
}

// Roll and pitch in degrees, from the attitude quaternion w-x-y-z.
function tilts(flight) {
  const [roll, pitch] = [new Float32Array(flight.length + 1), new Float32Array(flight.length + 1)];
  const degrees = 180 / Math.PI;
  for (let step = 0; step <= flight.length; step++) {
    const [w, x, y, z] = flight.positions.subarray(7 * step + 3, 7 * step + 7);
    roll[step] = degrees * Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y));
    pitch[step] = degrees * Math.asin(Math.max(-1, Math.min(1, 2 * (w * y - z * x))));
  }
  return [roll, pitch];
}

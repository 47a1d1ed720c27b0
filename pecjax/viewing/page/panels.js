// What is beside the map: the depth image, the traces, and the scale of the probabilities.
"use strict";

const INK = "#1c2733";
const TRACES = [
  { name: "speed", unit: "m/s", lines: [["asked for", "askedSpeed", "#e69f00"], ["flown", "speed", "#0072b2"]] },
  { name: "yaw rate asked for", unit: "rad/s", lines: [["", "askedYawRate", "#e69f00"]] },
  { name: "attitude", unit: "°", lines: [["roll", "roll", "#0072b2"], ["pitch", "pitch", "#d55e00"]] },
  { name: "distance to the goal", unit: "m", lines: [["", "distance", "#009e73"]] },
];

// A context whose units are those of the page, whatever the screen's density.
function context(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  pen.font = "11px system-ui, sans-serif";
  return [pen, width, height];
}

function drawDepth(canvas, data, flight, steps) {
  const { width, height, stride } = data.depthAbout;
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
    canvas.style.aspectRatio = `${width} / ${height}`;
  }
  const frame = Math.floor(Math.min(steps, flight.length) / stride);
  const from = (flight.firstImage + frame) * width * height;
  const image = new ImageData(width, height);
  for (let pixel = 0; pixel < width * height; pixel++) {
    const bright = 255 - data.depth[from + pixel]; // what is near is bright
    image.data.set([bright, bright, bright, 255], 4 * pixel);
  }
  canvas.getContext("2d").putImageData(image, 0, 0);
}

function drawTrace(canvas, data, flight, trace, steps) {
  const [pen, width, height] = context(canvas);
  const [left, right, top, bottom] = [36, width - 4, 18, height - 14];
  const all = trace.lines.flatMap(([, name]) => [...flight[name]]);
  let [low, high] = [Math.min(0, ...all), Math.max(0, ...all)];
  if (high - low < 1e-6) high = low + 1;
  const seconds = flight.length * data.period;
  const x = (step) => left + ((right - left) * step) / Math.max(flight.length, 1);
  const y = (value) => bottom - ((bottom - top) * (value - low)) / (high - low);
  pen.strokeStyle = "#d8dee4";
  pen.strokeRect(left, top, right - left, bottom - top);
  pen.fillStyle = INK;
  pen.fillText(`${trace.name} (${trace.unit})`, left, 12);
  pen.fillStyle = "#5b6875";
  pen.textAlign = "right";
  pen.fillText(high.toFixed(1), left - 4, top + 8);
  pen.fillText(low.toFixed(1), left - 4, bottom);
  pen.fillText(`${seconds.toFixed(1)} s`, right, height - 3);
  let place = right;
  for (const [label, name, color] of [...trace.lines].reverse()) {
    pen.fillStyle = color;
    pen.fillText(label, place, 12);
    place -= pen.measureText(label).width + 10;
    pen.strokeStyle = color;
    pen.lineWidth = 1.4;
    pen.beginPath();
    const values = flight[name];
    const holds = values.length === flight.length; // of a step, not of a moment
    values.forEach((value, step) => {
      pen.lineTo(x(step), y(value));
      if (holds) pen.lineTo(x(step + 1), y(value));
    });
    pen.stroke();
  }
  pen.textAlign = "left";
  pen.strokeStyle = INK;
  pen.lineWidth = 1;
  pen.beginPath();
  pen.moveTo(x(Math.min(steps, flight.length)), top);
  pen.lineTo(x(Math.min(steps, flight.length)), bottom);
  pen.stroke();
}

// Probability over 1/N on a logarithmic scale, as a colour (a part of viridis, dark to bright).
const SCALE = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];
const SPAN = 8; // from 1/8 to 8 times as often as by a uniform draw

function colorOf(relative) {
  const place = (Math.log(Math.max(relative, 1e-9)) / Math.log(SPAN) + 1) / 2;
  const at = Math.max(0, Math.min(1, place)) * (SCALE.length - 1);
  const index = Math.min(Math.floor(at), SCALE.length - 2);
  const [from, to] = [SCALE[index], SCALE[index + 1]].map((hex) =>
    [1, 3, 5].map((digit) => parseInt(hex.slice(digit, digit + 2), 16)),
  );
  return `rgb(${from.map((value, part) => Math.round(value + (at - index) * (to[part] - value))).join()})`;
}

function drawScale(canvas) {
  const [pen, width] = context(canvas);
  const gradient = pen.createLinearGradient(0, 0, width, 0);
  SCALE.forEach((color, place) => gradient.addColorStop(place / (SCALE.length - 1), color));
  pen.fillStyle = gradient;
  pen.fillRect(0, 0, width, 12);
  pen.fillStyle = INK;
  pen.fillText(`1/${SPAN}`, 0, 26);
  pen.textAlign = "center";
  pen.fillText("1/N", width / 2, 26);
  pen.textAlign = "right";
  pen.fillText(`${SPAN}/N`, width, 26);
}

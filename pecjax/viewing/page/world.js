// The map and its flights in three dimensions.
"use strict";

const COLORS = { goal: "#009e73", collision: "#d55e00", timeout: "#e69f00", other: "#7a7a7a" };
const SKY = "#dfe9f2";
const CHASE = { behind: 2.4, above: 1.1, ahead: 1.5 }; // m, of the drone
const CHASE_SMOOTHING = 0.12; // of the remaining way in each frame

const MANY = 40; // configurations, beyond which ribbons are thin

class World {
  constructor(canvas, data) {
    this.data = data;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(SKY);
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#8d99a6", 2.2));
    const sun = new THREE.DirectionalLight("#ffffff", 1.6);
    sun.position.set(-4, -7, 12);
    this.scene.add(sun);
    this.camera = new THREE.PerspectiveCamera(50, 1, 0.05, 5000);
    this.camera.up.set(0, 0, 1);
    this.orbit = new THREE.OrbitControls(this.camera, canvas);
    this.orbit.maxPolarAngle = 0.495 * Math.PI;
    this.mode = "free";
    this.chosen = 0;
    this.map = new THREE.Group();
    this.history = new THREE.Group();
    this.scene.add(this.map, this.history);
    this.flights = data.flights.map((flight) => new FlightView(flight, data));
    for (const view of this.flights) this.scene.add(view.group);
  }

  // Shows a map and leaves out the flights in all others.
  showMap(number) {
    this.map.clear();
    const { bounds, walls } = this.data.maps[number];
    const [[left, bottom], [right, top]] = bounds;
    this.center = new THREE.Vector3((left + right) / 2, (bottom + top) / 2, 0);
    this.extent = Math.max(right - left, top - bottom);
    const floor = new THREE.Mesh(
      new THREE.PlaneGeometry(right - left, top - bottom),
      new THREE.MeshLambertMaterial({ color: "#eef0ee" }),
    );
    floor.position.copy(this.center).setZ(-0.01);
    this.map.add(floor);
    this.wallMaterial = new THREE.MeshLambertMaterial({ color: "#b9c3cc", transparent: true });
    const edges = new THREE.LineBasicMaterial({ color: "#6d7883", transparent: true, opacity: 0.6 });
    for (const { lower, upper, cover } of walls) {
      if (cover) continue; // a floor or a ceiling, which would hide all the rest
      const size = upper.map((value, axis) => value - lower[axis]);
      const box = new THREE.BoxGeometry(...size);
      const wall = new THREE.Mesh(box, this.wallMaterial);
      wall.position.set(...lower.map((value, axis) => value + size[axis] / 2));
      const outline = new THREE.LineSegments(new THREE.EdgesGeometry(box), edges);
      outline.position.copy(wall.position);
      this.map.add(wall, outline);
    }
    this.setCamera(this.mode);
  }

  setCamera(mode) {
    this.mode = mode;
    this.orbit.enabled = mode !== "chase";
    this.orbit.enableRotate = mode === "free";
    const { x, y } = this.center;
    if (mode !== "chase") {
      const fit = this.extent / (2 * Math.tan((Math.PI * this.camera.fov) / 360) * Math.min(1, this.camera.aspect));
      if (mode === "top") this.camera.position.set(x, y - 0.001, 1.12 * fit + 2);
      else this.camera.position.set(x, y - 0.85 * fit, 0.85 * fit);
      this.orbit.target.set(x, y, 0);
      this.orbit.update();
    }
    this.wallMaterial.opacity = mode === "chase" ? 0.92 : 0.55;
    this.snap = true; // the next frame of a chase begins behind the drone
  }

  show(shown, chosen) {
    this.chosen = chosen;
    this.flights.forEach((view, number) => {
      view.group.visible = shown.includes(number);
      view.choose(number === chosen);
    });
    this.snap = true;
  }

  setTime(steps) {
    for (const view of this.flights) if (view.group.visible) view.setTime(steps);
  }

  // A ribbon from start to goal for each configuration of a map, coloured by how often it is drawn.
  showHistory(number, colors) {
    this.history.clear();
    if (!colors) return;
    const { starts, goals, maps } = this.data.history;
    const rows = [...colors.keys()].filter((row) => maps[row] === number);
    const width = rows.length > MANY ? 0.5 : 1;
    const box = new THREE.BoxGeometry(1, 0.1 * width, 0.02);
    const tip = new THREE.ConeGeometry(0.16 * width, 0.4 * width, 12).rotateZ(-Math.PI / 2);
    const ribbons = new THREE.InstancedMesh(box, new THREE.MeshBasicMaterial(), rows.length);
    const tips = new THREE.InstancedMesh(tip, new THREE.MeshBasicMaterial(), rows.length);
    rows.forEach((row, place) => {
      const [dx, dy] = [goals[row][0] - starts[row][0], goals[row][1] - starts[row][1]];
      const [length, angle] = [Math.max(Math.hypot(dx, dy), 0.01), Math.atan2(dy, dx)];
      // A pair and its reverse lie side by side, each to the right of its way.
      const [x, y] = [starts[row][0] + (0.12 * dy) / length, starts[row][1] - (0.12 * dx) / length];
      const turn = new THREE.Matrix4().makeRotationZ(angle);
      ribbons.setMatrixAt(
        place,
        new THREE.Matrix4()
          .makeTranslation(x + dx / 2, y + dy / 2, 0.05)
          .multiply(turn)
          .multiply(new THREE.Matrix4().makeScale(length, 1, 1)),
      );
      tips.setMatrixAt(place, new THREE.Matrix4().makeTranslation(x + dx, y + dy, 0.06).multiply(turn));
      const color = new THREE.Color(colors[row]);
      ribbons.setColorAt(place, color);
      tips.setColorAt(place, color);
    });
    this.history.add(ribbons, tips);
  }

  // The number of the flight whose drone is at a place of the canvas, in [-1, 1]².
  pick(x, y) {
    const ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2(x, y), this.camera);
    const near = this.flights
      .map((view, number) => [ray.ray.distanceToPoint(view.drone.position), number, view.group.visible])
      .filter(([distance, , visible]) => visible && distance < 0.6);
    return near.length ? near.reduce((a, b) => (a[0] < b[0] ? a : b))[1] : null;
  }

  render() {
    const canvas = this.renderer.domElement;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const ratio = Math.min(window.devicePixelRatio, 2);
    if (canvas.width !== Math.floor(width * ratio) || canvas.height !== Math.floor(height * ratio)) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      if (this.mode !== "chase") this.setCamera(this.mode);
    }
    if (this.mode === "chase") this.follow();
    this.renderer.render(this.scene, this.camera);
  }

  follow() {
    const drone = this.flights[this.chosen].drone;
    const ahead = new THREE.Vector3(1, 0, 0).applyQuaternion(drone.quaternion).setZ(0).normalize();
    const place = drone.position.clone().addScaledVector(ahead, -CHASE.behind);
    place.z += CHASE.above;
    this.camera.position.lerp(place, this.snap ? 1 : CHASE_SMOOTHING);
    this.camera.lookAt(drone.position.clone().addScaledVector(ahead, CHASE.ahead));
    this.snap = false;
  }
}

// One drone with its trail, its goal and the mark of its ending.
class FlightView {
  constructor(flight, data) {
    this.flight = flight;
    const color = COLORS[flight.ending];
    this.group = new THREE.Group();
    this.drone = drone(data.droneRadius, color);
    const points = new Float32Array(3 * (flight.length + 1));
    for (let step = 0; step <= flight.length; step++) {
      points.set(flight.positions.subarray(7 * step, 7 * step + 3), 3 * step);
    }
    const path = new THREE.BufferGeometry();
    path.setAttribute("position", new THREE.BufferAttribute(points, 3));
    this.trail = new THREE.Line(path, new THREE.LineBasicMaterial({ color, transparent: true }));
    this.goal = ring(data.goalRadius, flight.goal, color);
    this.end = endMark(flight, color);
    this.group.add(this.drone, this.trail, this.goal, this.end);
    if (flight.waypoint) this.group.add(ring(data.goalRadius, flight.waypoint, "#56b4e9"));
  }

  choose(chosen) {
    this.chosen = chosen;
    this.trail.material.opacity = chosen ? 1 : 0.55;
    this.goal.material.opacity = chosen ? 0.9 : 0.25;
    this.drone.scale.setScalar(chosen ? 1.25 : 1);
  }

  // Places the drone between two recorded poses; time is in control steps.
  setTime(steps) {
    const { positions, length } = this.flight;
    const now = Math.min(steps, length);
    const step = Math.min(Math.floor(now), Math.max(length - 1, 0));
    const [from, to] = [positions.subarray(7 * step), positions.subarray(7 * (step + 1))];
    const part = now - step;
    this.drone.position.set(...[0, 1, 2].map((axis) => from[axis] + part * (to[axis] - from[axis])));
    const [before, after] = [from, to].map((pose) => new THREE.Quaternion(pose[4], pose[5], pose[6], pose[3]));
    this.drone.quaternion.copy(before.slerp(after, part));
    for (const rotor of this.drone.userData.rotors) rotor.rotation.z = 2.1 * steps;
    this.trail.geometry.setDrawRange(0, Math.floor(now) + 1);
    this.end.visible = steps >= length;
  }
}

function drone(radius, color) {
  const group = new THREE.Group();
  const dark = new THREE.MeshLambertMaterial({ color: "#26323e" });
  const bright = new THREE.MeshLambertMaterial({ color });
  const blade = new THREE.MeshLambertMaterial({ color: "#54626f", transparent: true, opacity: 0.75 });
  const body = new THREE.Mesh(new THREE.SphereGeometry(0.32 * radius, 20, 12), bright);
  body.scale.set(1.35, 1, 0.6);
  const nose = new THREE.Mesh(new THREE.ConeGeometry(0.14 * radius, 0.4 * radius, 12), dark);
  nose.rotation.z = -Math.PI / 2;
  nose.position.x = 0.55 * radius;
  group.add(body, nose);
  group.userData.rotors = [];
  for (const [x, y] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
    const arm = new THREE.Mesh(new THREE.BoxGeometry(0.85 * radius, 0.07 * radius, 0.07 * radius), dark);
    arm.position.set(0.3 * radius * x, 0.3 * radius * y, 0);
    arm.rotation.z = Math.atan2(y, x);
    const guard = new THREE.Mesh(new THREE.TorusGeometry(0.34 * radius, 0.03 * radius, 8, 24), dark);
    const rotor = new THREE.Mesh(new THREE.BoxGeometry(0.62 * radius, 0.08 * radius, 0.02 * radius), blade);
    for (const part of [guard, rotor]) part.position.set(0.6 * radius * x, 0.6 * radius * y, 0.1 * radius);
    group.add(arm, guard, rotor);
    group.userData.rotors.push(rotor);
  }
  return group;
}

function ring(radius, [x, y], color) {
  const material = new THREE.MeshBasicMaterial({ color, transparent: true });
  const mesh = new THREE.Mesh(new THREE.RingGeometry(0.88 * radius, radius, 40), material);
  mesh.position.set(x, y, 0.02);
  return mesh;
}

// How a flight ended: a ball at a goal, a cross at a collision, a flat square where time ran out.
function endMark(flight, color) {
  const group = new THREE.Group();
  const material = new THREE.MeshLambertMaterial({ color });
  const bars = {
    goal: [new THREE.SphereGeometry(0.14, 16, 12)],
    collision: [0.25, -0.25].map((turn) => new THREE.BoxGeometry(0.6, 0.1, 0.1).rotateZ(turn * Math.PI)),
    timeout: [new THREE.BoxGeometry(0.32, 0.32, 0.06)],
    other: [new THREE.OctahedronGeometry(0.16)],
  };
  for (const shape of bars[flight.ending]) group.add(new THREE.Mesh(shape, material));
  const last = flight.positions.subarray(7 * flight.length);
  group.position.set(last[0], last[1], last[2] + 0.45);
  return group;
}

// What the viewer has chosen, and what follows from it on the page.
"use strict";

const NAMES = { goal: "reached the goal", collision: "collision", timeout: "out of time", other: "other ending" };
const byId = (id) => document.getElementById(id);

class Player {
  constructor(data) {
    this.data = data;
    this.world = new World(byId("world"), data);
    this.steps = 0;
    this.playing = false;
    this.pace = 1;
    this.fillFilters();
    this.makeTraces();
    this.makeHistory();
    this.listen();
    this.chosen = data.flights.reduce((best, flight, number) => (flight.length > data.flights[best].length ? number : best), 0);
    this.setMap(Object.keys(data.maps)[0]);
    this.readAddress();
    byId("message").remove();
    document.body.dataset.ready = "true";
  }

  fillFilters() {
    const fill = (id, all, options) => {
      const found = [["", all], ...options].map(([value, text]) => new Option(text, value));
      byId(id).append(...found);
    };
    const flights = this.data.flights;
    const endings = Object.keys(NAMES).filter((name) => flights.some((flight) => flight.ending === name));
    const configs = [...new Set(flights.map((flight) => flight.config))].sort((a, b) => a - b);
    fill("ending", "all", endings.map((name) => [name, NAMES[name]]));
    fill("config", "all", configs.map((config) => [config, `c${config}`]));
    for (const number of Object.keys(this.data.maps)) byId("map").append(new Option(number, number));
    byId("maps").hidden = Object.keys(this.data.maps).length < 2;
    byId("legend").append(
      ...endings.map((name) => {
        const entry = document.createElement("li");
        const color = document.createElement("i");
        color.style.background = COLORS[name];
        const number = flights.filter((flight) => flight.ending === name).length;
        entry.append(color, `${NAMES[name]} (${number})`);
        return entry;
      }),
    );
  }

  makeTraces() {
    this.traces = TRACES.map((trace) => {
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", trace.name);
      byId("traces").append(canvas);
      return [canvas, trace];
    });
  }

  makeHistory() {
    const history = this.data.history;
    if (!history) return;
    byId("history").hidden = false;
    byId("iteration").max = history.iterations.length - 1;
    byId("iteration").value = history.iterations.length - 1;
    drawScale(byId("scale"));
    for (const id of ["iteration", "show-history"]) byId(id).addEventListener("input", () => this.showHistory());
    byId("iteration").addEventListener("input", () => {
      byId("show-history").checked = true;
      this.showHistory();
    });
  }

  showHistory() {
    const history = this.data.history;
    if (!history) return;
    const place = Number(byId("iteration").value);
    const relative = this.data.relative.subarray(place * history.maps.length, (place + 1) * history.maps.length);
    byId("history-caption").textContent =
      `After iteration ${history.iterations[place]}: the probability of ${history.caption}, ` +
      "from a start to its goal, over that of a uniform draw.";
    const colors = byId("show-history").checked ? [...relative].map(colorOf) : null;
    this.world.showHistory(Number(this.map), colors);
    this.draw();
  }

  listen() {
    for (const id of ["ending", "config"]) byId(id).addEventListener("change", () => this.filter());
    byId("map").addEventListener("change", () => this.setMap(byId("map").value));
    byId("time").addEventListener("input", () => this.setTime(Number(byId("time").value)));
    byId("pace").addEventListener("change", () => (this.pace = Number(byId("pace").value)));
    byId("play").addEventListener("click", () => this.setPlaying(!this.playing));
    for (const button of document.querySelectorAll("[data-camera]")) {
      button.addEventListener("click", () => this.setCamera(button.dataset.camera));
    }
    byId("flights").addEventListener("click", (event) => {
      const row = event.target.closest("[data-flight]");
      if (row) this.choose(Number(row.dataset.flight));
    });
    byId("flights").addEventListener("keydown", (event) => this.moveChoice(event));
    this.pickOnClick(byId("world"));
    this.world.orbit.addEventListener("change", () => this.draw());
    window.addEventListener("resize", () => this.draw());
    window.addEventListener("keydown", (event) => this.onKey(event));
    window.addEventListener("hashchange", () => this.readAddress());
  }

  pickOnClick(canvas) {
    let pressed = null;
    canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
    canvas.addEventListener("pointerup", (event) => {
      if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4) return; // a drag
      const box = canvas.getBoundingClientRect();
      const x = (2 * (event.clientX - box.left)) / box.width - 1;
      const found = this.world.pick(x, 1 - (2 * (event.clientY - box.top)) / box.height);
      if (found !== null) this.choose(found);
    });
  }

  onKey(event) {
    if (event.target.matches("input, select, button, [role=listbox]")) return;
    const cameras = { 1: "free", 2: "chase", 3: "top" };
    if (event.key === " ") this.setPlaying(!this.playing);
    else if (event.key === "ArrowRight") this.setTime(Math.floor(this.steps) + 1);
    else if (event.key === "ArrowLeft") this.setTime(Math.ceil(this.steps) - 1);
    else if (event.key in cameras) this.setCamera(cameras[event.key]);
    else return;
    event.preventDefault();
  }

  moveChoice(event) {
    const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!by || !this.shown.length) return;
    const place = Math.max(0, Math.min(this.shown.length - 1, this.shown.indexOf(this.chosen) + by));
    this.choose(this.shown[place]);
    event.preventDefault();
  }

  setMap(number) {
    this.map = number;
    byId("map").value = number;
    this.world.showMap(number);
    this.filter();
    this.showHistory();
  }

  // Shows the flights of the map that have the ending and the configuration that are asked for.
  filter() {
    const [ending, config] = [byId("ending").value, byId("config").value];
    this.shown = this.data.flights.flatMap((flight, number) => {
      const fits = (!ending || flight.ending === ending) && (!config || flight.config === Number(config));
      return fits && flight.map === Number(this.map) ? [number] : [];
    });
    byId("count").textContent = `${this.shown.length} of ${this.data.flights.length} flights`;
    byId("flights").replaceChildren(...this.shown.map((number) => this.row(number)));
    if (this.shown.length && !this.shown.includes(this.chosen)) this.chosen = this.shown[0];
    const longest = Math.max(1, ...this.shown.map((number) => this.data.flights[number].length));
    byId("time").max = longest;
    this.choose(this.chosen);
    this.setTime(Math.min(this.steps, longest));
  }

  row(number) {
    const flight = this.data.flights[number];
    const row = document.createElement("div");
    row.dataset.flight = number;
    row.setAttribute("role", "option");
    const parts = ["i", "span", "span", "span"].map((kind) => document.createElement(kind));
    parts[0].style.background = COLORS[flight.ending];
    parts[1].textContent = `c${flight.config}`;
    parts[2].textContent = NAMES[flight.ending];
    parts[3].textContent = `${(flight.length * this.data.period).toFixed(1)} s`;
    row.append(...parts);
    return row;
  }

  choose(number) {
    this.chosen = number;
    this.world.show(this.shown, number);
    for (const row of byId("flights").children) {
      const selected = Number(row.dataset.flight) === number;
      row.setAttribute("aria-selected", selected);
      if (!selected) continue;
      const list = byId("flights"); // scrolled by itself: scrollIntoView would move the page on a phone
      list.scrollTop = Math.min(list.scrollTop, row.offsetTop);
      list.scrollTop = Math.max(list.scrollTop, row.offsetTop + row.offsetHeight - list.clientHeight);
    }
    this.draw();
  }

  setCamera(mode) {
    this.world.setCamera(mode);
    for (const button of document.querySelectorAll("[data-camera]")) {
      button.classList.toggle("on", button.dataset.camera === mode);
    }
    this.draw();
  }

  setTime(steps) {
    this.steps = Math.max(0, Math.min(steps, Number(byId("time").max)));
    byId("time").value = this.steps;
    this.draw();
  }

  setPlaying(playing) {
    this.playing = playing;
    byId("play").textContent = playing ? "⏸" : "▶";
    byId("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    if (!playing) return;
    if (this.steps >= Number(byId("time").max)) this.setTime(0);
    let before = null;
    const advance = (now) => {
      if (!this.playing) return;
      const seconds = before === null ? 0 : (now - before) / 1000;
      before = now;
      this.setTime(this.steps + (this.pace * seconds) / this.data.period);
      if (this.steps >= Number(byId("time").max)) this.setPlaying(false);
      else requestAnimationFrame(advance);
    };
    requestAnimationFrame(advance);
  }

  draw() {
    if (this.drawn) return; // once a frame is enough
    this.drawn = requestAnimationFrame(() => {
      this.drawn = null;
      const flight = this.data.flights[this.chosen];
      if (!this.playing) this.world.snap = true;
      this.world.setTime(this.steps);
      this.world.render();
      drawDepth(byId("depth"), this.data, flight, this.steps);
      for (const [canvas, trace] of this.traces) drawTrace(canvas, this.data, flight, trace, this.steps);
      const longest = Number(byId("time").max) * this.data.period;
      byId("clock").textContent = `${(this.steps * this.data.period).toFixed(1)} / ${longest.toFixed(1)} s`;
      const { near, far } = this.data.depthAbout;
      byId("depth-caption").textContent =
        `Flight in c${flight.config}: depth from ${near} m (bright) to ${far} m (dark).`;
    });
  }

  // What is behind the # of the page's address, such as #flight=3&time=4.2&camera=chase.
  readAddress() {
    const asked = new URLSearchParams(location.hash.slice(1));
    const flight = Number(asked.get("flight") ?? this.chosen);
    if (flight in this.data.flights) {
      if (this.data.flights[flight].map !== Number(this.map)) this.setMap(this.data.flights[flight].map);
      this.choose(flight);
    }
    if (asked.has("iteration") && this.data.history) {
      byId("iteration").value = asked.get("iteration");
      byId("show-history").checked = true;
      this.showHistory();
    }
    this.setCamera(["free", "chase", "top"].find((mode) => mode === asked.get("camera")) ?? this.world.mode);
    this.setTime(Number(asked.get("time") ?? 0) / this.data.period);
    this.setPlaying(!asked.has("time") && !matchMedia("(prefers-reduced-motion)").matches);
  }
}

readData(byId("data").textContent)
  .then((data) => (window.player = new Player(data)))
  .catch((error) => {
    byId("message").textContent = `This page cannot be shown: ${error.message}. A recent browser with WebGL is needed.`;
    throw error;
  });

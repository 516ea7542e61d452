// The page: time, keys and buttons, and what they move.

const SPEEDS = [1, 2, 5, 10, 20, 50, 100]; // slots a second
const WATCHED_S = 60; // a mission at the first speed takes at most this long, where a speed allows it
const TABLE_EVERY_MS = 300; // while it plays: a table that changes faster cannot be read
const PULSE_S = 0.8;

class Player {
  constructor(mission) {
    this.mission = mission;
    this.theme = new Theme(mission.oldest);
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    this.time = 1; // in slots; the present slot is the whole part
    this.playing = false;
    this.loop = false;
    this.speed = SPEEDS.find((speed) => mission.slots / speed <= WATCHED_S) ?? SPEEDS.at(-1);
    this.view = { layers: { coverage: true, trails: true, links: true, messages: true, numbers: false }, chosen: -1 };
    this.describe();
    this.maps = mission.flights.map((flight, k) => this.addMap(flight, k));
    this.chart = new AouChart(byId("chart"), mission, (slot) => this.seek(slot));
    this.table = new DeviceTable(byId("devices"), byId("table-policies"), mission, this.theme, (device) => this.choose(device));
    this.connect();
    this.setTheme(matchMedia("(prefers-color-scheme: dark)").matches);
    this.fit();
    const asked = Number(new URLSearchParams(location.hash.slice(1)).get("slot"));
    this.seek(asked || 1);
    if (!asked && !this.still.matches) this.play();
  }

  get slot() { return Math.floor(this.time); }

  // -- the parts of the page -----------------------------------------------------------------------------

  describe() {
    const { scenario, seed, slots, slotSeconds, uavs, devices, width, height } = this.mission;
    byId("title").textContent = `Replay: ${scenario}`;
    const size = `${whole.format(width)} × ${whole.format(height)} m`;
    const slotLength = slotSeconds.toLocaleString("en", { maximumSignificantDigits: 3 });
    byId("facts").textContent = [
      `${uavs} ${uavs === 1 ? "UAV" : "UAVs"}`, `${devices} ${devices === 1 ? "device" : "devices"}`, size,
      `${whole.format(slots)} slots of ${slotLength} s`, `mission ${seed}`,
    ].join(" · ");
    byId("scrub").max = slots;
    byId("of").textContent = `of ${whole.format(slots)}`;
    markEvents(byId("marks"), this.mission);
    for (const element of document.querySelectorAll("[data-item]")) element.hidden = !this.mission.operations[element.dataset.item];
    for (const speed of SPEEDS) append(byId("speed"), "option", "", `${speed} ${speed === 1 ? "slot" : "slots"}/s`).value = speed;
  }

  addMap(flight, k) {
    const card = append(byId("maps"), "article", "card flight");
    const head = append(card, "header");
    const title = append(head, "h3");
    if (this.mission.flights.length > 1) title.append(policyMark(k));
    append(title, "span", "", flight.name);
    const aou = append(head, "p", "aou", "AoU ");
    const now = append(aou, "strong");
    const more = append(card, "p", "more");
    const fleet = new FleetRows(card, flight);
    const ground = append(card, "div", "ground");
    const canvas = append(ground, "canvas");
    canvas.setAttribute("role", "img");
    const map = new FleetMap(canvas, flight, this.theme);
    ground.style.setProperty("--shape", map.extent[0] / map.extent[1]);
    canvas.addEventListener("click", (event) => {
      const box = canvas.getBoundingClientRect();
      this.choose(map.deviceAt(event.clientX - box.left, event.clientY - box.top));
    });
    const where = append(ground, "p", "where");
    canvas.addEventListener("pointermove", (event) => {
      const box = canvas.getBoundingClientRect();
      where.textContent = map.where(event.clientX - box.left, event.clientY - box.top);
    });
    canvas.addEventListener("pointerleave", () => { where.textContent = ""; });
    return Object.assign(map, { now, more, fleet });
  }

  connect() {
    byId("play").addEventListener("click", () => this.toggle());
    byId("back").addEventListener("click", () => this.pauseAt(this.slot - 1));
    byId("forward").addEventListener("click", () => this.pauseAt(this.slot + 1));
    byId("loop").addEventListener("click", () => this.setLoop(!this.loop));
    byId("scrub").addEventListener("input", (event) => this.seek(Number(event.target.value)));
    byId("speed").addEventListener("change", (event) => this.setSpeed(Number(event.target.value)));
    byId("theme-button").addEventListener("click", () => this.setTheme(!this.theme.dark));
    byId("help-button").addEventListener("click", (event) => {
      byId("help").hidden = !byId("help").hidden;
      event.currentTarget.setAttribute("aria-expanded", !byId("help").hidden);
    });
    for (const button of document.querySelectorAll("[data-layer]"))
      button.addEventListener("click", () => this.setLayer(button, button.getAttribute("aria-pressed") !== "true"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (event) => this.setTheme(event.matches));
    addEventListener("resize", () => this.fit());
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("hashchange", () => {
      const slot = Number(new URLSearchParams(location.hash.slice(1)).get("slot"));
      if (slot) this.pauseAt(slot);
    });
    this.setSpeed(this.speed);
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const on = event.target;
    if (on.matches("select") || (event.key === " " && on.matches("button"))) return; // they have keys of their own
    const far = event.shiftKey ? 10 : 1;
    const action = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.pauseAt(this.slot - far), ArrowRight: () => this.pauseAt(this.slot + far),
      Home: () => this.pauseAt(1), End: () => this.pauseAt(this.mission.slots),
      "+": () => this.nextSpeed(1), "=": () => this.nextSpeed(1), "-": () => this.nextSpeed(-1),
      l: () => this.setLoop(!this.loop), L: () => this.setLoop(!this.loop),
      Escape: () => this.choose(-1),
    }[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  // -- time ----------------------------------------------------------------------------------------------

  toggle() { this.playing ? this.pause() : this.play(); }

  play() {
    if (this.time >= this.mission.slots) this.time = 1;
    this.playing = true;
    this.before = performance.now();
    this.showPlaying();
    requestAnimationFrame((now) => this.tick(now));
  }

  pause() {
    this.playing = false;
    this.showPlaying();
    this.seek(this.slot);
  }

  pauseAt(slot) {
    this.playing = false;
    this.showPlaying();
    this.seek(slot);
  }

  /** Go to a slot; one beyond the mission's means its first or last. */
  seek(slot) {
    this.time = Math.max(1, Math.min(Math.round(slot) || 1, this.mission.slots));
    this.show(true);
    if (!this.playing) byId("status").textContent = this.words();
  }

  tick(now) {
    if (!this.playing) return;
    const passed = Math.max(0, Math.min(now - this.before, 500)); // a frame's time may lie before the click's
    this.time += (passed / 1000) * this.speed;
    this.before = now;
    if (this.time >= this.mission.slots) {
      if (!this.loop) { this.pauseAt(this.mission.slots); return; }
      this.time = 1;
    }
    this.show(now - (this.shown ?? 0) > TABLE_EVERY_MS);
    requestAnimationFrame((next) => this.tick(next));
  }

  setSpeed(speed) {
    this.speed = speed;
    byId("speed").value = speed;
  }

  nextSpeed(step) {
    const at = SPEEDS.indexOf(this.speed) + step;
    if (SPEEDS[at]) this.setSpeed(SPEEDS[at]);
  }

  setLoop(loop) {
    this.loop = loop;
    byId("loop").setAttribute("aria-pressed", loop);
  }

  // -- what is shown -------------------------------------------------------------------------------------

  /** Show the present time; and in the table if `withTable`. */
  show(withTable) {
    const slot = this.slot;
    const moves = this.playing && !this.still.matches;
    const time = moves ? this.time : slot;
    const pulse = moves ? Math.max(1, PULSE_S * this.speed) : 1;
    const view = { ...this.view, moves, pulse, packets: (performance.now() / 700) % 1 };
    for (const map of this.maps) {
      map.draw(time, view);
      if (map.slot !== slot) this.showFigures(map, slot);
      if (!this.playing) map.canvas.setAttribute("aria-label", map.words(slot));
    }
    this.chart.show(moves ? this.time : slot);
    byId("slot").textContent = `Slot ${whole.format(slot)}`;
    byId("time").textContent = duration(slot * this.mission.slotSeconds);
    const scrub = byId("scrub");
    scrub.value = slot;
    scrub.style.setProperty("--played", `${((time - 1) / Math.max(1, this.mission.slots - 1)) * 100}%`);
    scrub.setAttribute("aria-valuetext", `slot ${slot} of ${this.mission.slots}`);
    if (!withTable) return;
    this.shown = performance.now();
    this.table.show(slot);
  }

  showFigures(map, slot) {
    const { flight } = map;
    map.slot = slot;
    map.fleet.show(slot);
    map.now.textContent = whole.format(flight.aou[slot - 1]);
    map.more.textContent = `mean so far ${inWords(flight.aouSum[slot - 1] / slot)}, whole mission ${inWords(flight.meanAou)} slots (${inTime(this.mission, flight.meanAou)})\n`
      + `${flight.served[slot - 1]} of ${this.mission.devices} devices, ${whole.format(flight.communications[slot - 1])} communications`;
  }

  words() {
    const ages = this.mission.flights.map((flight) => `${flight.name} ${whole.format(flight.aou[this.slot - 1])}`);
    return `Slot ${this.slot} of ${this.mission.slots}. AoU in slots: ${ages.join(", ")}.`;
  }

  showPlaying() {
    byId("play").setAttribute("aria-label", this.playing ? "Pause" : "Play");
    byId("play").classList.toggle("playing", this.playing);
  }

  choose(device) {
    this.view.chosen = device === this.view.chosen ? -1 : device;
    this.table.choose(this.view.chosen);
    this.show(false);
  }

  setLayer(button, shown) {
    this.view.layers[button.dataset.layer] = shown;
    button.setAttribute("aria-pressed", shown);
    this.show(false);
  }

  setTheme(dark) {
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    byId("theme-button").setAttribute("aria-pressed", dark);
    this.theme.refresh();
    this.showScale();
    this.show(true);
  }

  /** Colours and sizes of devices, from an age of one slot to the largest of the mission. */
  showScale() {
    const bar = byId("age-bar");
    const { oldest } = this.mission;
    const powers = Array.from({ length: 9 }, (_, k) => 10 ** (k + 1));
    bar.replaceChildren();
    bar.style.background = this.theme.gradient();
    bar.setAttribute("aria-label", `from 1 to ${whole.format(oldest)} slots, on a scale of ratios; larger with age`);
    for (const age of [1, ...powers.filter((power) => this.theme.share(power) < (oldest < 1e5 ? 0.8 : 0.7)), oldest]) {
      const dot = append(bar, "i");
      dot.style.width = dot.style.height = `${2 * this.theme.radius(age)}px`;
      dot.style.background = this.theme.age(age);
      dot.style.left = `${100 * this.theme.share(age)}%`;
      append(bar, "span", "", whole.format(age) + (age === oldest ? " slots" : "")).style.left = dot.style.left;
    }
  }

  /** As many maps in a row as are large enough to read, and no higher than a window with its player. */
  fit() {
    const count = this.maps.length;
    document.querySelector("main").classList.toggle("few", count < 3); // then chart and table stand beside them
    const width = byId("maps").clientWidth;
    const most = width > 640 ? Math.max(1, Math.floor(width / 300)) : count > 1 ? 2 : 1;
    const rows = Math.ceil(count / most);
    byId("maps").style.setProperty("--columns", Math.ceil(count / rows));
    byId("maps").style.setProperty("--most-height", `${Math.max(300, innerHeight - 330)}px`);
    byId("maps").classList.toggle("several", count > 1);
    this.show(false);
  }
}

async function start() {
  try {
    window.replay = new Player(await readMission());
  } catch (error) {
    byId("problem").textContent = `The mission cannot be shown: ${error.message}. This page needs a browser of 2023 or later.`;
    byId("problem").hidden = false;
    throw error;
  }
}

start();

// What missions hold beside the paper's: batteries, swaps, failures, silent devices, messages between UAVs, wind.

const SEEN = ["battery", "swap_left", "failed", "news", "wind", "beyond", "late", "silent"];
const MANY_SWAPS = 80; // on the time line, from which on their marks are finer
const LOW = 0.25; // of a battery, from which on it is marked
const EVENTS = { failure: "fails", repair: "is repaired", swap: "swaps its battery" };

/** A time in the mission as on a clock: minutes and seconds, or hours and minutes. */
function clock(mission, slots) {
  const seconds = Math.round(slots * mission.slotSeconds);
  const [large, small, unit] = seconds < 3600 ? [60, 1, "min"] : [3600, 60, "h"];
  return `${Math.floor(seconds / large)}:${String(Math.floor((seconds % large) / small)).padStart(2, "0")} ${unit}`;
}

/** What there is to see in one flight, slot by slot. */
class Seen {
  static async read(content, mission) {
    const seen = new Seen();
    seen.mission = mission;
    for (const name of SEEN) if (content[name]) seen[name] = await unpack(content[name]);
    seen.events = seen.findEvents();
    return seen;
  }

  at(name, slot, place, width) { return this[name]?.[(slot - 1) * width + place] ?? 0; }
  charge(slot, u) { return this.at("battery", slot, u, this.mission.uavs) / 1000; }
  swapLeft(slot, u) { return this.at("swap_left", slot, u, this.mission.uavs); }
  hasFailed(slot, u) { return this.at("failed", slot, u, this.mission.uavs) > 0; }
  isLate(slot, i) { return this.at("late", slot, i, this.mission.devices) > 0; }
  isSilent(slot, i) { return this.at("silent", slot, i, this.mission.devices) > 0; }
  windAt(slot) { return [0, 1].map((axis) => this.at("wind", slot, axis, 2) / 10); } // m/s towards +x and +y

  /** How old u's news of v is in slots, up to the number from which on v is taken as lost. */
  newsAge(slot, u, v) { return this.at("news", slot, u * this.mission.uavs + v, this.mission.uavs ** 2); }

  /** Slots as a time without needless digits. */
  brief(slots) {
    const seconds = Math.round(slots * this.mission.slotSeconds);
    return seconds < 90 ? `${seconds} s` : `${Math.round(seconds / 6) / 10} min`;
  }

  findEvents() {
    const events = [];
    for (let slot = 1; slot <= this.mission.slots; slot++) {
      for (let uav = 0; uav < this.mission.uavs; uav++) {
        const [failed, before] = [this.hasFailed(slot, uav), slot > 1 && this.hasFailed(slot - 1, uav)];
        if (failed !== before) events.push({ slot, uav, kind: failed ? "failure" : "repair" });
        if (this.swapLeft(slot, uav) && !(slot > 1 && this.swapLeft(slot - 1, uav))) events.push({ slot, uav, kind: "swap" });
      }
    }
    return events;
  }

  /** The state of a UAV in words; empty where nothing is to be said. */
  state(slot, u) {
    if (this.hasFailed(slot, u)) {
      const last = this.events.findLast((one) => one.kind === "failure" && one.uav === u && one.slot <= slot);
      return `failed at ${clock(this.mission, last.slot)}`;
    }
    if (this.swapLeft(slot, u)) return `swap, ${this.brief(this.swapLeft(slot, u))} left`;
    return this.battery ? `${whole.format(100 * this.charge(slot, u))} %` : "";
  }

  /** How many devices are above the age limit, and beyond the capacity. */
  counts(slot) {
    const { operations, devices } = this.mission;
    const found = [];
    if (operations.age_limit_s) {
      const late = Array.from({ length: devices }, (_, i) => this.isLate(slot, i)).filter(Boolean).length;
      found.push(`${late} of ${devices} above the age limit of ${this.brief(operations.age_limit_s / this.mission.slotSeconds)}`);
    }
    if (operations.capacity) found.push(`${this.at("beyond", slot, 0, 1)} in range beyond the capacity of ${operations.capacity} a UAV`);
    return found;
  }
}

/** The rows of the UAVs below the figures of a map, and the counts. */
class FleetRows {
  constructor(card, flight) {
    const { operations, uavs } = flight.mission;
    this.flight = flight;
    this.list = append(card, "ul", "fleet");
    this.rows = Array.from({ length: operations.batteries || operations.failures ? uavs : 0 }, (_, u) => {
      const row = append(this.list, "li");
      const badge = append(row, "b", "", String(u));
      badge.style.background = `var(--uav-${u % UAV_COLOURS})`;
      badge.title = flight.mission.uavName(u);
      const bar = append(row, "span", "battery");
      bar.hidden = !operations.batteries;
      return { row, level: append(bar, "i"), state: append(row, "span") };
    });
    this.counts = flight.seen.counts(1).map(() => append(this.list, "li", "counts"));
    this.list.hidden = !this.list.children.length;
  }

  show(slot) {
    const { seen } = this.flight;
    this.rows.forEach(({ row, level, state }, u) => {
      const share = seen.swapLeft(slot, u) ? 0 : seen.charge(slot, u);
      row.classList.toggle("failed", seen.hasFailed(slot, u));
      row.classList.toggle("low", share < LOW);
      level.style.width = `${100 * share}%`;
      state.textContent = seen.state(slot, u) || "flies";
    });
    seen.counts(slot).forEach((text, k) => { this.counts[k].textContent = text; });
  }
}

/** Failures, repairs and swaps of all flights above the time line. */
function markEvents(holder, mission) {
  const events = new Map(mission.flights.flatMap((flight) => flight.seen.events)
    .map((one) => [`${one.kind} ${one.uav} ${one.slot}`, one]));
  holder.hidden = !events.size;
  const words = [];
  for (const { slot, uav, kind } of events.values()) {
    const mark = append(holder, "i", kind);
    mark.style.setProperty("--at", (slot - 1) / Math.max(1, mission.slots - 1));
    mark.style.color = `var(--uav-${uav % UAV_COLOURS})`;
    mark.title = `${mission.uavName(uav)} ${EVENTS[kind]} at ${clock(mission, slot)}`;
    if (kind !== "swap") words.push(mark.title);
  }
  const swaps = [...events.values()].filter((one) => one.kind === "swap").length;
  holder.classList.toggle("many", swaps > MANY_SWAPS);
  holder.setAttribute("aria-label", [...words, `${swaps} ${swaps === 1 ? "swap" : "swaps"} of batteries`].join("; "));
}

// -- on the map ------------------------------------------------------------------------------------------

/** Where batteries are swapped beside the CDSs: squares with a plus. */
function drawSwapStations(map, pen) {
  for (const [x, y] of map.mission.operations.stations_m ?? []) {
    const [left, top, half] = [map.x(x), map.y(y), 6.5 * map.unit];
    pen.strokeStyle = map.theme.ink;
    pen.fillStyle = map.theme.field;
    pen.lineWidth = 1.5 * map.unit;
    pen.beginPath();
    pen.roundRect(left - half, top - half, 2 * half, 2 * half, 2.5 * map.unit);
    pen.fill();
    pen.moveTo(left - half / 2, top);
    pen.lineTo(left + half / 2, top);
    pen.moveTo(left, top - half / 2);
    pen.lineTo(left, top + half / 2);
    pen.stroke();
  }
}

/** Lines between UAVs: the half at each is fainter the older its news of the other is, dashed from one slot on. */
function drawNews(map, pen, time) {
  const { uavs, operations } = map.mission;
  const slot = Math.floor(time);
  const places = Array.from({ length: uavs }, (_, u) => map.spot(time, u));
  pen.strokeStyle = map.theme.ink;
  for (let u = 0; u < uavs; u++) {
    for (let v = 0; v < uavs; v++) {
      const age = map.flight.seen.newsAge(slot, u, v);
      if (u === v || age >= operations.silence_slots) continue;
      pen.globalAlpha = 0.6 * (1 - age / operations.silence_slots);
      pen.lineWidth = (age ? 1 : 1.5) * map.unit;
      pen.setLineDash(age ? [3, 4] : []);
      pen.beginPath();
      pen.moveTo(...places[u]);
      pen.lineTo(...[0, 1].map((axis) => (places[u][axis] + places[v][axis]) / 2));
      pen.stroke();
    }
  }
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

/** A diamond around a device above the age limit. */
function drawLate(map, pen, [x, y], radius) {
  const reach = radius + 5 * map.unit;
  pen.strokeStyle = map.theme.forbidden;
  pen.lineWidth = 1.5 * map.unit;
  pen.beginPath();
  for (const [dx, dy] of [[0, -reach], [reach, 0], [0, reach], [-reach, 0]]) pen.lineTo(x + dx, y + dy);
  pen.closePath();
  pen.stroke();
}

/** A cross over a failed UAV; below the others, what is left in the battery. */
function drawCondition(map, pen, slot, u, [x, y]) {
  const { seen } = map.flight;
  const size = map.unit;
  if (seen.hasFailed(slot, u)) {
    pen.strokeStyle = map.theme.ink;
    pen.lineWidth = 2.8 * size;
    pen.beginPath();
    for (const side of [-1, 1]) {
      pen.moveTo(x - 15 * size, y - 15 * side * size);
      pen.lineTo(x - 8 * size, y - 8 * side * size);
      pen.moveTo(x + 8 * size, y + 8 * side * size);
      pen.lineTo(x + 15 * size, y + 15 * side * size);
    }
    pen.stroke();
    return;
  }
  if (!seen.battery) return;
  const [width, height] = [26 * size, 5 * size];
  const [left, top] = [x - width / 2, y + 16 * size];
  const swaps = seen.swapLeft(slot, u) > 0;
  const share = seen.charge(slot, u);
  pen.fillStyle = map.theme.field;
  pen.strokeStyle = map.theme.ink;
  pen.lineWidth = 1;
  pen.fillRect(left, top, width, height);
  pen.fillStyle = share < LOW ? map.theme.forbidden : map.theme.ink;
  if (!swaps) pen.fillRect(left, top, share * width, height);
  pen.strokeRect(left, top, width, height);
  if (!swaps) return;
  pen.font = `600 ${Math.round(10 * Math.max(size, 0.85))}px system-ui, sans-serif`;
  pen.textAlign = "center";
  pen.lineWidth = 3;
  pen.strokeStyle = map.theme.field;
  pen.fillStyle = map.theme.ink;
  const middle = Math.max(16, Math.min(x, map.size[0] - 16)); // not beyond the border
  pen.strokeText("swap", middle, top + height + 10 * size);
  pen.fillText("swap", middle, top + height + 10 * size);
}

/** An arrow in the upper left corner that points to where the wind blows, with its speed. */
function drawWind(map, pen, slot) {
  const [east, north] = map.flight.seen.windAt(slot);
  const speed = Math.hypot(east, north);
  const size = map.unit;
  pen.save();
  pen.translate(20 * size, 18 * size);
  pen.fillStyle = pen.strokeStyle = map.theme.ink;
  pen.font = `600 ${Math.round(11 * Math.max(size, 0.85))}px system-ui, sans-serif`;
  pen.textAlign = "left";
  pen.fillText(`${speed.toFixed(1)} m/s`, 18 * size, 4 * size);
  pen.rotate(-Math.atan2(north, east));
  pen.scale(size, size);
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(-12, 0);
  pen.lineTo(6, 0);
  pen.stroke();
  pen.beginPath();
  pen.moveTo(12, 0);
  pen.lineTo(4, -5);
  pen.lineTo(4, 5);
  if (speed > 0.05) pen.fill();
  pen.restore();
}

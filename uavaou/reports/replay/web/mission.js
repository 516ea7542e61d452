// The mission as arrays: slot t is row t - 1, and ages are in slots.

const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
const fine = new Intl.NumberFormat("en", { minimumFractionDigits: 1, maximumFractionDigits: 1 });
const inWords = (value) => (value < 100 ? fine : whole).format(value);
const byId = (id) => document.getElementById(id);

/** A new element with a class and a text, at the end of its parent. */
function append(parent, tag, className = "", text = "") {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  parent.append(element);
  return element;
}

/** The whole numbers that the page holds as base64 of compressed 32-bit words. */
async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const words = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Int32Array(await new Response(words).arrayBuffer());
}

/** Sums down the columns of a table of that width, in place. */
function sumDown(table, width) {
  for (let at = width; at < table.length; at++) table[at] += table[at - width];
  return table;
}

/** What one policy did in the mission. */
class Flight {
  static async read(content, mission) {
    const [cells, carriedBy, bends] = await Promise.all(
      [content.cells, content.carried_by, content.age_bends].map(unpack));
    const ages = sumDown(sumDown(bends, mission.devices), mission.devices);
    return Object.assign(new Flight(content.name, mission, cells, carriedBy, ages), { seen: await Seen.read(content, mission) });
  }

  constructor(name, mission, cells, carriedBy, ages) {
    Object.assign(this, { name, mission, cells, carriedBy, ages });
    const { slots, devices } = mission;
    this.aou = new Float64Array(slots); // at each slot's end, all devices together
    this.aouSum = new Float64Array(slots); // over the slots so far
    this.communications = new Int32Array(slots); // so far
    this.served = new Int32Array(slots); // devices with a communication so far
    const met = new Uint8Array(devices);
    for (let row = 0, aouSum = 0, count = 0, served = 0; row < slots; row++) {
      for (let i = 0; i < devices; i++) {
        this.aou[row] += ages[row * devices + i];
        if (carriedBy[row * devices + i] < 0) continue;
        count += 1;
        served += 1 - met[i];
        met[i] = 1;
      }
      this.aouSum[row] = aouSum += this.aou[row];
      this.communications[row] = count;
      this.served[row] = served;
    }
  }

  get meanAou() { return this.aouSum.at(-1) / this.mission.slots; }

  age(slot, device) { return this.ages[(slot - 1) * this.mission.devices + device]; }

  /** The UAV that the device sent updates to in the slot, or -1. */
  carrier(slot, device) { return this.carriedBy[(slot - 1) * this.mission.devices + device]; }

  /** Where a UAV is at a time in slots, in m: in a straight line from its place in a slot to that in the next. */
  place(time, uav) {
    const { slots, uavs, step } = this.mission;
    const row = Math.min(Math.floor(time), slots) - 1;
    const next = Math.min(row + 1, slots - 1);
    const from = (row * uavs + uav) * 2;
    const to = (next * uavs + uav) * 2;
    const share = Math.min(time - row - 1, 1);
    const along = (axis) => (this.cells[from + axis] + share * (this.cells[to + axis] - this.cells[from + axis])) * step;
    return [along(0), along(1)];
  }

  /** The figures of each device up to a slot. */
  devicesAt(slot) {
    const { devices } = this.mission;
    const found = Array.from({ length: devices }, (_, i) => ({
      device: i, period: this.mission.periods[i], age: this.age(slot, i), mean: 0, communications: 0, last: 0, carrier: "",
    }));
    for (let row = 0, at = 0; row < slot; row++) {
      for (const one of found) {
        one.mean += this.ages[at];
        const uav = this.carriedBy[at++];
        if (uav < 0) continue;
        one.communications += 1;
        one.last = row + 1;
        one.carrier = this.mission.uavName(uav);
      }
    }
    for (const one of found) one.mean /= slot;
    return found;
  }
}

/** The mission that the page holds, with a flight for each policy. */
async function readMission() {
  const content = JSON.parse(byId("mission").textContent);
  const mission = {
    scenario: content.scenario, seed: content.mission_seed, slots: content.slots, slotSeconds: content.slot_length_s,
    width: content.area_m[0], height: content.area_m[1], step: content.grid_step_m, stations: content.cds_m,
    altitudes: content.altitudes_m, uavs: content.cds_m.length, devices: content.devices.x_m.length,
    x: content.devices.x_m, y: content.devices.y_m, periods: content.devices.update_period_slots,
    coverage: content.devices.coverage_m, outline: content.outline_m, zones: content.zones ?? [],
    bearing: content.bearing_deg, corners: content.corners_deg, operations: content.operations ?? {},
  };
  mission.deviceName = (i) => content.device_names?.[i] ?? `Device ${i}`;
  mission.uavName = (u) => content.uav_names?.[u] ?? `UAV ${u}`;
  mission.named = Boolean(content.device_names);
  mission.flights = await Promise.all(content.policies.map((policy) => Flight.read(policy, mission)));
  mission.oldest = mission.flights.reduce((most, flight) => flight.ages.reduce((a, b) => Math.max(a, b), most), 2);
  return mission;
}

/** Latitude and longitude of a place on the map, between those of its corners; null where nothing says where it lies. */
function degreesAt(mission, x, y) {
  if (!mission.corners) return null;
  const [right, up] = [x / mission.width, y / mission.height];
  const shares = [(1 - right) * (1 - up), right * (1 - up), (1 - right) * up, right * up];
  return [0, 1].map((axis) => shares.reduce((sum, share, k) => sum + share * mission.corners[k][axis], 0));
}

/** Slots as minutes, or seconds where they are few. */
function inTime(mission, slots) {
  const seconds = slots * mission.slotSeconds;
  return seconds < 90 ? `${inWords(seconds)} s` : `${inWords(seconds / 60)} min`;
}

/** A time in the mission as a person says it. */
function duration(seconds) {
  const rounded = Math.round(seconds);
  const hours = Math.floor(rounded / 3600);
  const minutes = Math.floor(rounded / 60) % 60;
  const parts = [hours && `${hours} h`, (hours || minutes) && `${minutes} min`, !hours && `${rounded % 60} s`];
  return parts.filter(Boolean).join(" ");
}

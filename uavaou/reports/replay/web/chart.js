// AoU over the mission, a line for each policy, with a cursor that can be dragged.

const WIDE_RATIO = 5; // between the largest and the lowest mean, above which the axis is logarithmic
const DRAWN_POINTS = 1200;

class AouChart {
  constructor(holder, mission, seek) {
    Object.assign(this, { holder, mission, flights: mission.flights });
    const values = this.flights.map((flight) => flight.aou.reduce((a, b) => Math.max(a, b)));
    const means = this.flights.map((flight) => Math.max(flight.meanAou, 1));
    this.top = Math.max(...values, 1);
    this.log = this.top > WIDE_RATIO * Math.min(...means);
    this.low = this.log ? this.lowest() : 0;
    this.window = 1 + 2 * Math.round(mission.slots / 50); // slots of the moving mean
    byId("thick").textContent = this.window > 1 ? `; thick: mean of ${this.window} slots` : "";
    new ResizeObserver(() => this.layOut()).observe(holder);
    const drag = (event) => {
      if (event.type === "pointermove" && !event.buttons) return;
      if (event.type === "pointerdown") holder.setPointerCapture(event.pointerId);
      seek(this.slotAt(event.clientX - holder.getBoundingClientRect().left));
    };
    holder.addEventListener("pointerdown", drag);
    holder.addEventListener("pointermove", drag);
  }

  x(slot) { return this.left + ((slot - 1) / Math.max(1, this.mission.slots - 1)) * this.width; }

  /** What all but the lowest hundredth of the values reach. */
  lowest() {
    const values = this.flights.flatMap((flight) => [...flight.aou]).sort((a, b) => a - b);
    return Math.max(1, Math.min(values[Math.floor(values.length / 100)], this.top / 2));
  }

  y(aou) {
    const share = this.log ? Math.log(Math.max(aou, this.low) / this.low) / Math.log(this.top / this.low) : aou / this.top;
    return this.base - share * (this.base - 8);
  }

  slotAt(x) {
    const slot = 1 + Math.round(((x - this.left) / this.width) * (this.mission.slots - 1));
    return Math.max(1, Math.min(slot, this.mission.slots));
  }

  ticks() {
    if (this.log) {
      const digits = this.top / this.low > 300 ? [1] : [1, 2, 5];
      const all = Array.from({ length: 12 }, (_, k) => digits.map((digit) => digit * 10 ** k)).flat();
      return all.filter((tick) => tick >= this.low && tick <= this.top);
    }
    const step = roundStep(this.top / 4);
    return Array.from({ length: Math.floor(this.top / step) + 1 }, (_, k) => k * step);
  }

  /** The values of a flight as a line: a point for each slot, or for several where there are more than can be drawn. */
  path(values) {
    const together = Math.ceil(values.length / DRAWN_POINTS);
    const points = [];
    for (let row = 0; row < values.length; row += together)
      points.push(`${this.x(row + 1).toFixed(1)} ${this.y(values[row]).toFixed(1)}`);
    return `M${points.join("L")}`;
  }

  /** The mean over the slots around each slot. */
  smoothed(flight) {
    const half = (this.window - 1) / 2;
    const { slots } = this.mission;
    return flight.aou.map((_, row) => {
      const [first, last] = [Math.max(0, row - half), Math.min(slots - 1, row + half)];
      return (flight.aouSum[last] - (first ? flight.aouSum[first - 1] : 0)) / (last - first + 1);
    });
  }

  layOut() {
    const width = this.holder.clientWidth;
    if (!width) return;
    const height = Math.max(150, Math.min(230, window.innerHeight * 0.21));
    const roomy = width > 560;
    const longest = Math.max(...this.flights.map((flight) => flight.name.length));
    this.left = 14 + 7 * whole.format(this.top).length;
    this.width = width - this.left - (roomy ? Math.min(30 + 7.2 * longest, 190) : 22);
    this.base = height - 20;
    const rows = this.ticks().map((tick) => `<line class="tick" x1="${this.left}" x2="${this.left + this.width}" y1="${this.y(tick)}" y2="${this.y(tick)}"/>
      <text x="${this.left - 7}" y="${this.y(tick) + 4}" text-anchor="end">${whole.format(tick)}</text>`);
    const every = roundStep(this.mission.slots / (roomy ? 9 : 4.5));
    const columns = Array.from({ length: Math.floor(this.mission.slots / every) }, (_, k) => (k + 1) * every);
    const below = [1, ...columns.filter((slot) => slot > 1)].map((slot) => `<text x="${this.x(slot)}" y="${height - 3}" text-anchor="middle">${whole.format(slot)}</text>`);
    const lines = this.flights.flatMap((flight, k) => [["each", flight.aou, ""], ["mean", this.smoothed(flight), DASHES[k % DASHES.length]]]
      .flatMap(([kind, values, dash]) => ["ahead", "past"].map((side) => `<g class="${side}" clip-path="url(#${side})"><path class="line ${kind}"
        d="${this.path(values)}" stroke-dasharray="${dash}" style="stroke: ${policyColour(k)}"/></g>`)));
    const labels = this.labelPlaces().map((y, k) => `<g style="color: ${policyColour(k)}">${shapeMark(k, this.left + this.width + 13, y, 4)}
      <text class="label" x="${this.left + this.width + 22}" y="${y + 4}" style="fill: ${policyColour(k)}"></text></g>`);
    const dots = this.flights.map((_, k) => `<g class="at" style="color: ${policyColour(k)}">${shapeMark(k, 0, 0, 4.6)}</g>`);
    this.holder.innerHTML = `<svg role="img" aria-labelledby="chart-title" viewBox="0 0 ${width} ${height}" style="height: ${height}px">
      <clipPath id="past"><rect x="0" y="-10" width="0" height="${height + 10}"/></clipPath>
      <clipPath id="ahead"><rect x="0" y="-10" width="${width}" height="${height + 10}"/></clipPath>
      ${rows.join("")}${below.join("")}${this.events()}${lines.join("")}${labels.join("")}
      <line class="cursor" y1="0" y2="${this.base}"/>${dots.join("")}</svg>`;
    if (roomy) this.holder.querySelectorAll(".label").forEach((label, k) => { label.textContent = short(this.flights[k].name); });
    [this.past, this.ahead] = ["#past", "#ahead"].map((side) => this.holder.querySelector(`${side} rect`));
    this.cursor = this.holder.querySelector(".cursor");
    this.dots = [...this.holder.querySelectorAll(".at")];
    if (this.time) this.show(this.time);
  }

  /** A line at each failure and repair. */
  events() {
    const all = this.flights.flatMap((flight) => flight.seen.events).filter((one) => one.kind !== "swap");
    const slots = new Map(all.map((one) => [`${one.kind} ${one.slot}`, one])).values();
    return [...slots].map(({ kind, slot }) => `<line class="event ${kind}" x1="${this.x(slot)}" x2="${this.x(slot)}" y1="0" y2="${this.base}"/>
      <text x="${this.x(slot) + 3}" y="9">${kind}</text>`).join("");
  }

  /** Heights for the labels at the right end: near their lines, and apart from each other. */
  labelPlaces() {
    const wanted = this.flights.map((flight, k) => {
      const last = flight.aou.subarray(-Math.ceil(this.mission.slots / 10));
      return { k, y: this.y(last.reduce((a, b) => a + b) / last.length) };
    }).sort((a, b) => a.y - b.y);
    wanted.forEach((one, k) => { one.y = Math.max(one.y, k ? wanted[k - 1].y + 16 : 6); });
    const beyond = Math.max(0, wanted.at(-1).y - this.base);
    const places = [];
    for (const one of wanted) places[one.k] = one.y - beyond;
    return places;
  }

  /** Move the cursor to a time in slots. */
  show(time) {
    this.time = time;
    if (!this.past) return;
    const x = this.x(Math.min(time, this.mission.slots));
    this.past.setAttribute("width", x);
    this.ahead.setAttribute("x", x);
    this.cursor.setAttribute("x1", x);
    this.cursor.setAttribute("x2", x);
    this.dots.forEach((dot, k) => dot.setAttribute("transform", `translate(${x} ${this.y(this.flights[k].aou[Math.floor(time) - 1])})`));
  }
}

const short = (name) => (name.length > 24 ? `${name.slice(0, 23)}…` : name);

/** The next larger of 1, 2, 5, 10, 20 and so on. */
function roundStep(least) {
  const power = 10 ** Math.floor(Math.log10(Math.max(least, 1)));
  return [1, 2, 5, 10].map((digit) => digit * power).find((size) => size >= least);
}

// The devices under one policy, sorted by any column.

const COLUMNS = [
  { key: "device", title: "Device" },
  { key: "period", title: "Period", text: (one) => whole.format(one.period) },
  { key: "age", title: "Age", text: (one) => whole.format(one.age) },
  { key: "mean", title: "Mean age", text: (one) => inWords(one.mean) },
  { key: "communications", title: "Collected", text: (one) => whole.format(one.communications) },
  { key: "last", title: "Last in", text: (one) => (one.last ? `${whole.format(one.last)}, ${one.carrier}` : "never") },
];

class DeviceTable {
  constructor(table, switches, mission, theme, choose) {
    Object.assign(this, { mission, theme, key: "age", rising: false, flight: mission.flights[0], slot: 1 });
    const head = append(append(table, "thead"), "tr");
    this.heads = COLUMNS.map((column) => {
      const cell = append(head, "th");
      cell.scope = "col";
      append(cell, "button", "", column.title).addEventListener("click", () => this.sortBy(column.key));
      return cell;
    });
    this.body = append(table, "tbody");
    this.rows = mission.x.map((_, device) => {
      const row = append(this.body, "tr");
      const cells = COLUMNS.map(() => append(row, "td"));
      const button = append(cells[0], "button");
      const chip = append(button, "span", "chip");
      append(button, "span", "", mission.named ? mission.deviceName(device) : String(device));
      button.setAttribute("aria-label", mission.deviceName(device));
      row.addEventListener("click", () => choose(device));
      return { row, cells, chip, button };
    });
    this.switches = mission.flights.length > 1 ? mission.flights.map((flight) => {
      const button = append(switches, "button", "", flight.name);
      button.addEventListener("click", () => this.showFlight(flight));
      return button;
    }) : [];
    this.showFlight(this.flight);
  }

  showFlight(flight) {
    this.flight = flight;
    this.switches.forEach((button, k) => button.setAttribute("aria-pressed", this.mission.flights[k] === flight));
    this.show(this.slot);
  }

  /** Sort by a column: the largest first, and the other way round when asked again. */
  sortBy(key) {
    this.rising = key === this.key ? !this.rising : key === "device" || key === "period";
    this.key = key;
    this.show(this.slot);
  }

  show(slot) {
    this.slot = slot;
    const found = this.flight.devicesAt(slot);
    for (const one of found) {
      const { row, cells, chip } = this.rows[one.device];
      row.classList.toggle("late", this.flight.seen.isLate(slot, one.device));
      row.classList.toggle("silent", this.flight.seen.isSilent(slot, one.device));
      COLUMNS.forEach((column, k) => { if (column.text) cells[k].textContent = column.text(one); });
      chip.style.background = this.theme.age(one.age);
    }
    const sign = this.rising ? 1 : -1;
    found.sort((a, b) => sign * (a[this.key] - b[this.key]) || a.device - b.device);
    found.forEach((one, place) => {
      const { row } = this.rows[one.device];
      if (this.body.children[place] !== row) this.body.insertBefore(row, this.body.children[place]);
    });
    this.heads.forEach((head, k) => {
      if (COLUMNS[k].key === this.key) head.setAttribute("aria-sort", this.rising ? "ascending" : "descending");
      else head.removeAttribute("aria-sort");
    });
  }

  choose(device) {
    this.rows.forEach(({ row, button }, i) => {
      row.classList.toggle("chosen", i === device);
      button.setAttribute("aria-pressed", i === device);
    });
  }
}

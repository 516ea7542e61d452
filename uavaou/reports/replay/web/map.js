// The map of one policy: the ground once for each size and theme, and on it what moves.

const TRAIL_SLOTS = 40;
const MARGIN = 0.075; // of the longer side, around the area

class FleetMap {
  constructor(canvas, flight, theme) {
    Object.assign(this, { canvas, flight, theme, mission: flight.mission });
    this.ground = document.createElement("canvas");
    this.groundKey = "";
    const { width, height } = this.mission;
    this.extent = [width, height].map((side) => side + 2 * MARGIN * Math.max(width, height)); // m
  }

  /** Fit the canvas to its place on the screen; whether there is one. */
  measure() {
    const { clientWidth, clientHeight } = this.canvas;
    const dense = Math.min(window.devicePixelRatio || 1, 3);
    const size = [Math.round(clientWidth * dense), Math.round(clientHeight * dense)];
    if (this.canvas.width !== size[0] || this.canvas.height !== size[1]) [this.canvas.width, this.canvas.height] = size;
    this.dense = dense;
    this.size = [clientWidth, clientHeight];
    this.scale = Math.min(clientWidth / this.extent[0], clientHeight / this.extent[1]); // pixels a metre
    this.left = (clientWidth - this.mission.width * this.scale) / 2;
    this.bottom = (clientHeight + this.mission.height * this.scale) / 2;
    this.cell = this.mission.step * this.scale;
    this.unit = Math.max(0.62, Math.min(1.25, clientWidth / 460)); // of what has no length on the ground
    return clientWidth > 0;
  }

  x(metres) { return this.left + metres * this.scale; }
  y(metres) { return this.bottom - metres * this.scale; }

  /** The UAV's place on the canvas; UAVs on one way are drawn side by side. */
  spot(time, uav) {
    const [x, y] = this.flight.place(time, uav);
    const apart = Math.min(0.09, 0.4 / this.mission.uavs) * this.mission.step * (uav - (this.mission.uavs - 1) / 2);
    return [this.x(x + apart), this.y(y + apart)];
  }

  deviceRadius(age) { return this.theme.radius(age) * this.unit; }

  /** The device within a finger's reach of a point on the canvas, or -1. */
  deviceAt(x, y) {
    let nearest = -1;
    let least = 18;
    for (let i = 0; i < this.mission.devices; i++) {
      const distance = Math.hypot(this.x(this.mission.x[i]) - x, this.y(this.mission.y[i]) - y);
      if (distance < least) [nearest, least] = [i, distance];
    }
    return nearest;
  }

  /** Draw a moment: `time` in slots; `view` has the layers, the chosen device, and how long a pulse lasts in slots. */
  draw(time, view) {
    if (!this.measure()) return;
    const pen = this.canvas.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.drawImage(this.drawnGround(view), 0, 0);
    pen.setTransform(this.dense, 0, 0, this.dense, 0, 0);
    pen.lineCap = pen.lineJoin = "round";
    const slot = Math.floor(time);
    if (view.chosen >= 0) this.drawReach(pen, view.chosen);
    if (view.layers.trails) this.drawTrails(pen, time);
    if (view.layers.links) this.drawLinks(pen, time, view);
    if (this.mission.operations.links && view.layers.messages) drawNews(this, pen, time);
    this.drawDevices(pen, slot, view);
    this.drawPulses(pen, time, view);
    for (let u = 0; u < this.mission.uavs; u++) this.drawUav(pen, u, this.spot(time, u), slot);
    if (this.mission.operations.wind) drawWind(this, pen, slot);
    if (view.chosen >= 0) this.drawName(pen, view.chosen, slot);
  }

  // -- what stands still ---------------------------------------------------------------------------------

  drawnGround(view) {
    const key = [...this.size, this.dense, this.theme.dark, view.layers.coverage, view.layers.numbers].join();
    if (key === this.groundKey) return this.ground;
    this.groundKey = key;
    [this.ground.width, this.ground.height] = [this.canvas.width, this.canvas.height];
    const pen = this.ground.getContext("2d");
    pen.scale(this.dense, this.dense);
    pen.fillStyle = this.theme.field;
    pen.fillRect(0, 0, ...this.size);
    if (view.layers.coverage) this.drawCoverage(pen);
    this.drawGrid(pen);
    this.drawZones(pen);
    this.drawStations(pen);
    drawSwapStations(this, pen);
    this.drawScale(pen);
    this.drawNorth(pen);
    return this.ground;
  }

  /** Where a UAV reaches devices: a tint for each, so that it is darker where more are within reach. */
  drawCoverage(pen) {
    const { x, y, coverage, devices, width, height } = this.mission;
    const covered = coverage.reduce((sum, radius) => sum + Math.min(Math.PI * radius ** 2, width * height), 0);
    const together = Math.max(1, covered / (width * height)); // devices within reach, about
    pen.save();
    pen.beginPath();
    pen.rect(this.x(0), this.y(height), width * this.scale, height * this.scale);
    pen.clip();
    pen.fillStyle = pen.strokeStyle = this.theme.cover;
    for (let i = 0; i < devices; i++) {
      pen.beginPath();
      pen.arc(this.x(x[i]), this.y(y[i]), coverage[i] * this.scale, 0, 2 * Math.PI);
      pen.globalAlpha = Math.min(0.12, 0.22 / together);
      pen.fill();
      pen.globalAlpha = Math.min(0.2, 0.5 / together);
      pen.lineWidth = 0.7;
      pen.stroke();
    }
    pen.restore();
  }

  drawGrid(pen) {
    const { width, height, step } = this.mission;
    pen.strokeStyle = this.theme.grid;
    pen.lineWidth = 1;
    pen.strokeRect(this.x(0), this.y(height), width * this.scale, height * this.scale);
    if (this.cell < 7) return; // a finer grid would be a grey area
    pen.fillStyle = this.theme.grid;
    const dot = Math.min(1.3, this.cell / 14);
    for (let x = 0; x <= width + 1e-6; x += step) {
      for (let y = 0; y <= height + 1e-6; y += step) {
        pen.beginPath();
        pen.arc(this.x(x), this.y(y), dot, 0, 2 * Math.PI);
        pen.fill();
      }
    }
  }

  /** The outline, and where UAVs may not fly: hatched, with its name. */
  drawZones(pen) {
    const { outline, zones } = this.mission;
    const trace = (polygon) => {
      pen.beginPath();
      polygon.forEach(([x, y], k) => (k ? pen.lineTo(this.x(x), this.y(y)) : pen.moveTo(this.x(x), this.y(y))));
      pen.closePath();
    };
    if (outline) {
      trace(outline);
      pen.strokeStyle = this.theme.soft;
      pen.lineWidth = 1.4;
      pen.setLineDash([7, 4]);
      pen.stroke();
      pen.setLineDash([]);
    }
    for (const { polygon_m: polygon, name } of zones) {
      pen.save();
      trace(polygon);
      pen.strokeStyle = pen.fillStyle = this.theme.forbidden;
      pen.lineWidth = 1.2;
      pen.stroke();
      pen.globalAlpha = 0.1;
      pen.fill();
      pen.clip();
      pen.globalAlpha = 0.5;
      pen.lineWidth = 0.8;
      pen.beginPath();
      for (let at = -this.size[1]; at < this.size[0]; at += 9) {
        pen.moveTo(at, this.size[1]);
        pen.lineTo(at + this.size[1], 0);
      }
      pen.stroke();
      pen.restore();
      if (!name) continue;
      const [x, y] = [0, 1].map((axis) => polygon.reduce((sum, corner) => sum + corner[axis], 0) / polygon.length);
      pen.font = `600 ${Math.round(10.5 * Math.max(this.unit, 0.85))}px system-ui, sans-serif`;
      pen.textAlign = "center";
      pen.lineWidth = 3;
      pen.strokeStyle = this.theme.field;
      pen.strokeText(name, this.x(x), this.y(y));
      pen.fillStyle = this.theme.forbidden;
      pen.fillText(name, this.x(x), this.y(y));
    }
  }

  /** An arrow to the north, in the upper right corner, where the scenario says where that is. */
  drawNorth(pen) {
    if (this.mission.bearing === undefined) return;
    pen.save();
    pen.translate(this.size[0] - 18 * this.unit, 20 * this.unit);
    pen.rotate((-this.mission.bearing * Math.PI) / 180);
    pen.scale(this.unit, this.unit);
    pen.fillStyle = this.theme.soft;
    pen.beginPath();
    pen.moveTo(0, -11);
    pen.lineTo(5, 4);
    pen.lineTo(0, 1);
    pen.lineTo(-5, 4);
    pen.fill();
    pen.font = "600 9px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.fillText("N", 0, 14);
    pen.restore();
  }

  drawStations(pen) {
    this.mission.stations.forEach(([x, y], u) => {
      const shared = this.mission.stations.slice(0, u).filter((other) => other[0] === x && other[1] === y).length;
      const half = (7 + 4 * shared) * this.unit;
      pen.strokeStyle = this.theme.uav(u);
      pen.lineWidth = 1.8 * this.unit;
      pen.beginPath();
      pen.roundRect(this.x(x) - half, this.y(y) - half, 2 * half, 2 * half, 3.5 * this.unit);
      pen.stroke();
    });
  }

  /** A bar of a round length, below the area. */
  drawScale(pen) {
    const most = this.mission.width / 6;
    const power = 10 ** Math.floor(Math.log10(most));
    const metres = [5, 2, 1].map((digit) => digit * power).find((length) => length <= most);
    const text = metres >= 1000 ? `${metres / 1000} km` : `${metres} m`;
    const right = this.x(this.mission.width) - 14 * this.unit; // beside a station
    const at = this.y(0) + 12 * this.unit;
    pen.strokeStyle = pen.fillStyle = this.theme.soft;
    pen.lineWidth = 1.2;
    pen.beginPath();
    pen.moveTo(right - metres * this.scale, at - 4);
    pen.lineTo(right - metres * this.scale, at);
    pen.lineTo(right, at);
    pen.lineTo(right, at - 4);
    pen.stroke();
    pen.font = `${Math.round(11 * Math.max(this.unit, 0.8))}px system-ui, sans-serif`;
    pen.textAlign = "right";
    pen.fillText(text, right - metres * this.scale - 6, at);
  }

  // -- what moves ----------------------------------------------------------------------------------------

  drawTrails(pen, time) {
    const slot = Math.floor(time);
    const first = Math.max(1, slot - TRAIL_SLOTS);
    pen.lineWidth = 2.1 * this.unit;
    for (let u = 0; u < this.mission.uavs; u++) {
      pen.strokeStyle = this.theme.uav(u);
      let from = this.spot(first, u);
      for (let t = first + 1; t <= slot + 1; t++) {
        const to = this.spot(Math.min(t, time), u);
        if (from[0] !== to[0] || from[1] !== to[1]) {
          pen.globalAlpha = 0.06 + 0.74 * ((t - first) / (TRAIL_SLOTS + 1)) ** 1.6;
          pen.beginPath();
          pen.moveTo(...from);
          pen.lineTo(...to);
          pen.stroke();
        }
        from = to;
      }
    }
    pen.globalAlpha = 1;
  }

  /** Links that carry updates in the slot, with packets that run to the UAV. */
  drawLinks(pen, time, view) {
    const slot = Math.floor(time);
    const share = time - slot;
    for (let i = 0; i < this.mission.devices; i++) {
      const uav = this.flight.carrier(slot, i);
      if (uav < 0) continue;
      const from = [this.x(this.mission.x[i]), this.y(this.mission.y[i])];
      const to = this.spot(time, uav);
      const colour = this.theme.uav(uav);
      pen.strokeStyle = pen.fillStyle = colour;
      pen.globalAlpha = 0.75 * (1 - 0.6 * share);
      pen.lineWidth = 1.5 * this.unit;
      pen.beginPath();
      pen.moveTo(...from);
      pen.lineTo(...to);
      pen.stroke();
      pen.globalAlpha = 1;
      for (const start of [0.15, 0.5, 0.85]) {
        const along = view.moves ? (start + view.packets) % 1 : start;
        pen.beginPath();
        pen.arc(from[0] + along * (to[0] - from[0]), from[1] + along * (to[1] - from[1]), 2 * this.unit, 0, 2 * Math.PI);
        pen.fill();
      }
    }
  }

  drawDevices(pen, slot, view) {
    const { x, y, devices } = this.mission;
    pen.textAlign = "left";
    pen.font = `${Math.round(10.5 * Math.max(this.unit, 0.85))}px system-ui, sans-serif`;
    for (let i = 0; i < devices; i++) {
      const age = this.flight.age(slot, i);
      const radius = this.deviceRadius(age);
      const at = [this.x(x[i]), this.y(y[i])];
      pen.beginPath();
      pen.arc(...at, radius, 0, 2 * Math.PI);
      const silent = this.flight.seen.isSilent(slot, i);
      pen.fillStyle = silent ? this.theme.field : this.theme.age(age);
      pen.fill();
      pen.strokeStyle = this.theme.rim;
      pen.globalAlpha = 0.8;
      pen.lineWidth = silent ? 1.6 : 0.9;
      pen.stroke();
      pen.globalAlpha = 1;
      if (this.flight.seen.isLate(slot, i)) drawLate(this, pen, at, radius);
      if (!view.layers.numbers) continue;
      pen.fillStyle = this.theme.soft;
      pen.fillText(this.mission.named ? this.mission.deviceName(i) : String(i), at[0] + radius + 2, at[1] - radius + 1);
    }
  }

  /** A ring that grows from each device after a communication, in the colour of the UAV. */
  drawPulses(pen, time, view) {
    const slot = Math.floor(time);
    const first = Math.max(1, Math.ceil(time - view.pulse));
    for (let i = 0; i < this.mission.devices; i++) {
      for (let t = slot; t >= first; t--) {
        const uav = this.flight.carrier(t, i);
        if (uav < 0) continue;
        const grown = Math.max(0, (time - t) / view.pulse);
        pen.strokeStyle = this.theme.uav(uav);
        pen.globalAlpha = 0.95 * (1 - grown) ** 1.3;
        pen.lineWidth = (2.2 - grown) * this.unit;
        pen.beginPath();
        pen.arc(this.x(this.mission.x[i]), this.y(this.mission.y[i]), (6 + 15 * grown) * this.unit, 0, 2 * Math.PI);
        pen.stroke();
        break;
      }
    }
    pen.globalAlpha = 1;
  }

  /** A quadcopter with its number; a failed one is grey. */
  drawUav(pen, u, [x, y], slot) {
    const failed = this.flight.seen.hasFailed(slot, u);
    const size = this.unit;
    pen.save();
    pen.translate(x, y);
    pen.shadowColor = this.theme.dark ? "#000a" : "#0005";
    pen.shadowBlur = 5 * this.dense;
    pen.shadowOffsetY = 2 * this.dense;
    pen.fillStyle = pen.strokeStyle = failed ? this.theme.soft : this.theme.uav(u);
    pen.lineWidth = 2.4 * size;
    pen.beginPath();
    for (const [dx, dy] of [[1, 1], [-1, 1]]) {
      pen.moveTo(-9 * dx * size, -9 * dy * size);
      pen.lineTo(9 * dx * size, 9 * dy * size);
    }
    pen.stroke();
    pen.shadowColor = "transparent";
    for (const [dx, dy] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
      pen.beginPath();
      pen.arc(9 * dx * size, 9 * dy * size, 4.6 * size, 0, 2 * Math.PI);
      pen.globalAlpha = 0.35;
      pen.fill();
      pen.globalAlpha = 1;
      pen.lineWidth = 1.1 * size;
      pen.stroke();
    }
    pen.beginPath();
    pen.arc(0, 0, 8.2 * size, 0, 2 * Math.PI);
    pen.fill();
    pen.strokeStyle = this.theme.field;
    pen.lineWidth = 1.3 * size;
    pen.stroke();
    pen.fillStyle = failed ? this.theme.field : this.theme.onUav(u);
    pen.font = `700 ${Math.round(10.5 * size)}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(String(u), 0, 0.6 * size);
    pen.restore();
    drawCondition(this, pen, slot, u, [x, y]);
  }

  // -- the chosen device ---------------------------------------------------------------------------------

  drawReach(pen, device) {
    const at = [this.x(this.mission.x[device]), this.y(this.mission.y[device])];
    pen.save();
    pen.beginPath();
    pen.rect(this.x(0), this.y(this.mission.height), this.mission.width * this.scale, this.mission.height * this.scale);
    pen.clip();
    pen.beginPath();
    pen.arc(...at, Math.max(this.mission.coverage[device] * this.scale, 10), 0, 2 * Math.PI);
    pen.fillStyle = pen.strokeStyle = this.theme.accent;
    pen.globalAlpha = 0.14;
    pen.fill();
    pen.globalAlpha = 1;
    pen.lineWidth = 1.4;
    pen.setLineDash([5, 4]);
    pen.stroke();
    pen.restore();
  }

  drawName(pen, device, slot) {
    const age = this.flight.age(slot, device);
    const text = `${this.mission.deviceName(device)}: ${whole.format(age)} slots, ${inTime(this.mission, age)}`;
    pen.font = "600 12px system-ui, sans-serif";
    const width = pen.measureText(text).width + 14;
    const x = this.x(this.mission.x[device]);
    const y = this.y(this.mission.y[device]);
    const left = Math.max(3, Math.min(x - width / 2, this.size[0] - width - 3));
    const top = y > 44 ? y - 40 : y + 18;
    pen.fillStyle = this.theme.ink;
    pen.beginPath();
    pen.roundRect(left, top, width, 22, 6);
    pen.fill();
    pen.fillStyle = this.theme.card;
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.fillText(text, left + 7, top + 11.5);
    pen.textBaseline = "alphabetic";
  }

  /** A point on the canvas in words: metres, and degrees where they are known. */
  where(left, top) {
    const [x, y] = [(left - this.left) / this.scale, (this.bottom - top) / this.scale];
    const degrees = degreesAt(this.mission, x, y);
    const metres = `x ${whole.format(x)}, y ${whole.format(y)} m`;
    return degrees ? `${metres} · ${degrees.map((angle) => angle.toFixed(6)).join(", ")}` : metres;
  }

  /** What the map shows in a slot, in words. */
  words(slot) {
    const { uavs, slots } = this.mission;
    const places = Array.from({ length: uavs }, (_, u) => {
      const [x, y] = this.flight.place(slot, u);
      const state = this.flight.seen.state(slot, u);
      return `${this.mission.uavName(u)} at ${whole.format(x)}, ${whole.format(y)} m${state && `, ${state}`}`;
    });
    return `Map of ${this.flight.name}, slot ${slot} of ${slots}: ${places.join("; ")}`;
  }
}

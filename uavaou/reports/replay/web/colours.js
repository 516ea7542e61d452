// Colours: those of the theme, and the scale of ages.

// Magma, of even steps for the eye: from the oldest to the freshest on light ground, the other way round on dark.
const MAGMA = ["#1d1147", "#51127c", "#832681", "#b73779", "#e75263", "#fc8961", "#fec488", "#fcfdbf"];
const POLICY_COLOURS = 6;
const UAV_COLOURS = 8;
const DASHES = ["", "7 3", "2 2.5", "9 3 2 3"];
const SHAPES = ["circle", "square", "diamond", "triangle", "cross"]; // not as many as dashes: pairs repeat late

const channels = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));

/** The colours of the present theme, for what is drawn without style sheets. */
class Theme {
  constructor(oldest) {
    this.oldest = oldest;
    this.refresh();
  }

  refresh() {
    this.dark = document.documentElement.dataset.theme === "dark";
    const style = getComputedStyle(document.documentElement);
    for (const name of ["ink", "soft", "card", "field", "grid", "cover", "rim", "line", "accent", "forbidden"])
      this[name] = style.getPropertyValue(`--${name}`).trim();
    this.uavs = Array.from({ length: UAV_COLOURS }, (_, u) => style.getPropertyValue(`--uav-${u}`).trim());
    this.stops = (this.dark ? MAGMA : [...MAGMA].reverse()).map(channels);
  }

  uav(u) { return this.uavs[u % UAV_COLOURS]; }

  /** Ink that can be read on a UAV. */
  onUav(u) {
    const [red, green, blue] = channels(this.uav(u));
    return 0.3 * red + 0.59 * green + 0.11 * blue > 140 ? "#10151c" : "#ffffff";
  }

  /** Where an age stands between fresh (0) and the oldest of the mission (1), on a scale of ratios. */
  share(age) { return age <= 1 ? 0 : Math.log(age) / Math.log(this.oldest); }

  /** The radius of a device in pixels, on a map of usual size. */
  radius(age) { return 2.7 + 4.2 * this.share(age); }

  age(age) {
    const place = this.share(age) * (this.stops.length - 1);
    const low = Math.min(Math.floor(place), this.stops.length - 2);
    const mixed = this.stops[low].map((from, k) => Math.round(from + (place - low) * (this.stops[low + 1][k] - from)));
    return `rgb(${mixed})`;
  }

  gradient() { return `linear-gradient(to right, ${this.stops.map((stop) => `rgb(${stop})`)})`; }
}

const policyColour = (k) => `var(--policy-${k % POLICY_COLOURS})`;

/** The line and the mark of a policy, as in the chart. */
function policyMark(k) {
  const svg = `<svg class="mark" viewBox="0 0 26 14" aria-hidden="true" style="color: ${policyColour(k)}">
    <path d="M1 7H25" stroke="currentColor" stroke-width="2" stroke-dasharray="${DASHES[k % DASHES.length]}"/>
    ${shapeMark(k, 13, 7, 4.2)}</svg>`;
  const holder = document.createElement("template");
  holder.innerHTML = svg;
  return holder.content.firstElementChild;
}

/** The mark of a policy as SVG. */
function shapeMark(k, x, y, r) {
  const arm = r * 0.42;
  const reach = 1.15 * r - arm;
  const paths = {
    circle: `M${x - r} ${y}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0z`,
    square: `M${x - r * 0.9} ${y - r * 0.9}h${1.8 * r}v${1.8 * r}h${-1.8 * r}z`,
    diamond: `M${x} ${y - 1.2 * r}L${x + 1.2 * r} ${y}L${x} ${y + 1.2 * r}L${x - 1.2 * r} ${y}z`,
    triangle: `M${x} ${y - 1.1 * r}L${x + 1.15 * r} ${y + 0.9 * r}H${x - 1.15 * r}z`,
    cross: `M${x - arm - reach} ${y - arm}h${reach}v${-reach}h${2 * arm}v${reach}h${reach}v${2 * arm}h${-reach}v${reach}h${-2 * arm}v${-reach}h${-reach}z`,
  };
  return `<path class="dot" d="${paths[SHAPES[k % SHAPES.length]]}" fill="currentColor"/>`;
}

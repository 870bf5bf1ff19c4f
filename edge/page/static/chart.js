// One course in two rows: temperatures above, what drives them below, on one axis of time.

import { html, useEffect, useRef } from "./ui.js";

const HOUR = 3600;
const AHEAD = HOUR; // shown beyond now [s]
const TEMPS = 260; // heights [px]
const DRIVES = 110;

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// The predictor that says how sure it is and was nearest lately, and its forecast of the newest tick.
export function bestForecast(status) {
  const tick = status?.tick;
  if (!tick) return null;
  const error = (name) => status.skill?.[name]?.horizons?.["15"]?.mae_k ?? 9;
  const sure = Object.entries(tick.forecasts).filter(([, one]) => one.half_width_k["15"] != null);
  if (!sure.length) return null;
  const [name, found] = sure.reduce((a, b) => (error(b[0]) < error(a[0]) ? b : a));
  const minutes = Object.keys(found.temp_c).map(Number).sort((a, b) => a - b);
  const air = tick.readings.temp_air_c?.value ?? tick.estimate.temp_air_c;
  const rows = [[tick.utc, air, 0]];
  for (const m of minutes) rows.push([tick.utc + 60 * m, found.temp_c[m], found.half_width_k[m] ?? 0]);
  return { name, rows: rows.filter((row) => row[1] != null) };
}

// What was, and what is expected, as columns for uPlot.
export function columnsOf(course, status) {
  const past = [
    course.utc, course.air_low_c, course.air_high_c, course.air_c, course.reference_c, course.room_c,
    course.heater, course.fan,
  ];
  const tick = status?.tick;
  if (!tick) return [...past, ...Array.from({ length: 6 }, () => course.utc.map(() => null))];
  const forecast = bestForecast(status)?.rows ?? [];
  const band = [
    forecast.map((row) => row[0]), forecast.map((row) => row[1] - row[2]), forecast.map((row) => row[1] + row[2]),
    forecast.map((row) => row[1]),
  ];
  const at = (status.plan ?? []).map((_, k) => tick.utc + k * tick.step_s);
  const plan = [at, status.plan.map((step) => step[0]), status.plan.map((step) => step[1])];
  const coming = [tick.why?.reference_c ?? []].flat(); // a number where the controller does not look ahead
  const reference = [coming.map((_, k) => tick.utc + k * tick.step_s), coming];
  return uPlot.join([past, band, plan, reference]);
}

function axis(show, size, format) {
  return {
    stroke: style("--quiet"), grid: { stroke: style("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui",
    size: show ? size : 0, show, values: (_, splits) => splits.map(format),
  };
}

// A time on the axis: the hour, and at midnight the day.
function dayTime(utc) {
  const at = new Date(1000 * utc);
  const isMidnight = at.getHours() === 0 && at.getMinutes() === 0;
  return isMidnight ? at.toLocaleDateString([], { day: "numeric", month: "short" })
    : at.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", hourCycle: "h23" });
}

function options(width, height, isTop, pick, pan) {
  const line = (label, colour, more = {}) => ({
    label, stroke: style(colour), width: 2, spanGaps: false, points: { show: false }, ...more,
  });
  const hidden = (label) => ({ label, show: !isTop ? false : true, stroke: "transparent", width: 0, points: { show: false } });
  const steps = uPlot.paths.stepped({ align: 1 });
  const off = { show: false };
  const temps = [
    hidden("low"), hidden("high"),
    line("air", "--air"),
    line("reference", "--reference", { paths: steps, width: 1.5 }),
    line("room", "--room", { width: 1.5 }),
    off, off,
    hidden("low"), hidden("high"),
    line("forecast", "--air", { dash: [4, 4], spanGaps: true }),
    off, off,
    line("reference to come", "--reference", { paths: steps, dash: [4, 4], width: 1.5, spanGaps: true }),
  ];
  const drives = [
    off, off, off, off, off,
    line("heater", "--heater", { paths: steps, fill: `${style("--heater")}33` }),
    line("fan", "--fan", { paths: steps, width: 1.5 }),
    off, off, off,
    line("heater planned", "--heater", { paths: steps, dash: [4, 4], spanGaps: true }),
    line("fan planned", "--fan", { paths: steps, dash: [4, 4], width: 1.5, spanGaps: true }),
    off,
  ];
  return {
    width, height, legend: { show: false }, padding: [8, 12, isTop ? 8 : 0, 0],
    cursor: { sync: { key: "greenhouse" }, drag: { x: false, y: false, setScale: false } },
    scales: {
      x: { time: true, range: (_, low, high) => [low, high] },
      y: isTop ? { range: (_, low, high) => (low == null ? [15, 35] : [Math.floor(low - 0.5), Math.ceil(high + 0.5)]) }
        : { range: () => [0, 1.05] },
    },
    axes: [axis(!isTop, 34, dayTime), axis(true, 44, isTop ? (v) => `${v}°` : (v) => `${Math.round(100 * v)} %`)],
    series: [{}, ...(isTop ? temps : drives)],
    bands: isTop ? [{ series: [2, 1], fill: `${style("--air")}22` }, { series: [9, 8], fill: `${style("--air")}33` }] : [],
    hooks: { ready: [(chart) => listen(chart, pick, pan)] },
  };
}

// A drag moves in time, a tap asks why. On a touch screen a vertical drag still scrolls the page.
function listen(chart, pick, pan) {
  let from = null;
  const over = chart.over;
  over.addEventListener("pointerdown", (event) => {
    from = { x: event.clientX, moved: false };
    over.setPointerCapture(event.pointerId);
  });
  over.addEventListener("pointermove", (event) => {
    if (!from || Math.abs(event.clientX - from.x) < 4) return;
    from.moved = true;
    pan(chart.posToVal(0, "x") - chart.posToVal(event.clientX - from.x, "x"));
    from.x = event.clientX;
  });
  over.addEventListener("pointerup", (event) => {
    if (from && !from.moved) pick(chart.posToVal(event.offsetX, "x"));
    from = null;
  });
  over.addEventListener("pointercancel", () => (from = null));
}

// first, last : the times shown [s since 1970]; pick(utc) : a moment was tapped; pan(seconds) : move in time
export function Chart({ columns, first, last, pick, pan, now }) {
  const place = useRef(null);
  const charts = useRef([]);
  const handlers = useRef({});
  handlers.current = { pick, pan };
  useEffect(() => {
    const draw = () => {
      charts.current.forEach((chart) => chart.destroy());
      const width = place.current.clientWidth;
      const made = [true, false].map((isTop) => new uPlot(
        options(width, isTop ? TEMPS : DRIVES, isTop, (utc) => handlers.current.pick(utc), (s) => handlers.current.pan(s)),
        columns, place.current,
      ));
      charts.current = made;
      made.forEach((chart) => chart.setScale("x", { min: first, max: last }));
    };
    draw();
    const resized = new ResizeObserver(() => {
      const width = place.current?.clientWidth;
      charts.current.forEach((chart, k) => width && chart.setSize({ width, height: k ? DRIVES : TEMPS }));
    });
    resized.observe(place.current);
    const dark = matchMedia("(prefers-color-scheme: dark)");
    dark.addEventListener("change", draw);
    return () => {
      resized.disconnect();
      dark.removeEventListener("change", draw);
      charts.current.forEach((chart) => chart.destroy());
    };
  }, []);
  useEffect(() => {
    charts.current.forEach((chart) => {
      chart.setData(columns, false);
      chart.setScale("x", { min: first, max: last });
    });
  }, [columns, first, last]);
  return html`<div class="chart" ref=${place} role="img" aria-label="Course of temperatures, heater and fan"></div>`;
}

export const LEGEND = [
  ["air", "--air", "air"], ["forecast, 90 %", "--air", "dashed"], ["reference", "--reference", "line"],
  ["room", "--room", "line"], ["heater", "--heater", "line"], ["fan", "--fan", "line"], ["planned", "--heater", "dashed"],
];
export const spanAhead = AHEAD;

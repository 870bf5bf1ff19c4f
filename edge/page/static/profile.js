// A profile: targets over days that somebody draws, types or loads; how far it is, and orders to it.

import { html, useRef, useState } from "./ui.js";
import { call } from "./api.js";
import { Do, degrees } from "./parts.js";

const HOUR = 3600;
const WIDE = 600; // of the drawing, in its own units
const HIGH = 180;
const LOW_C = 10;
const TOP_C = 40;
const EMPTY = [[0, 24], [6, 28], [18, 22]]; // hours, °C

const lasts = (seconds) => {
  const minutes = Math.round(seconds / 60);
  const [days, hours] = [Math.floor(minutes / 1440), Math.floor(minutes / 60) % 24];
  return days ? `${days} d ${hours} h` : hours ? `${hours} h ${minutes % 60} min` : `${minutes} min`;
};

// Rows of hours and °C of a CSV file with time_s and reference_c; an error names the line.
export function rowsOf(text) {
  const lines = text.split(/\r?\n/).map((line, k) => [line.trim(), k + 1]).filter(([line]) => line && !line.startsWith("#"));
  const names = (lines.shift()?.[0] ?? "").split(",").map((name) => name.trim());
  const [time, target] = [names.indexOf("time_s"), names.indexOf("reference_c")];
  if (time < 0 || target < 0) throw new Error("the file needs the columns time_s and reference_c");
  return lines.map(([line, number]) => {
    const cells = line.split(",");
    const row = [Number(cells[time]?.trim() || NaN) / HOUR, Number(cells[target]?.trim() || NaN)];
    if (!row.every(Number.isFinite)) throw new Error(`line ${number}: "${line.slice(0, 40)}" has no two numbers there`);
    return row;
  });
}

// The targets as a line, with the place that is reached; points can be dragged, a tap beside them adds one.
function Drawing({ rows, linear, at, change }) {
  const area = useRef(null);
  const held = useRef(null); // the point that is dragged, and the span of time meanwhile
  const span = held.current?.span ?? Math.max(1, rows.at(-1)[0] * 1.15);
  const x = (hours) => (WIDE * hours) / span;
  const y = (value) => HIGH * (1 - (value - LOW_C) / (TOP_C - LOW_C));
  const shown = rows.filter((row) => row.every(Number.isFinite));
  const line = shown.flatMap(([hours, value], k) => (k && !linear ? [[hours, shown[k - 1][1]], [hours, value]] : [[hours, value]]));
  const path = [...line, [span, shown.at(-1)?.[1] ?? 20]].map(([hours, value]) => `${x(hours)},${y(value)}`).join(" ");
  const place = (event) => {
    const box = area.current.getBoundingClientRect();
    const hours = (span * (event.clientX - box.left)) / box.width;
    const value = TOP_C - ((TOP_C - LOW_C) * (event.clientY - box.top)) / box.height;
    return [Math.max(0, Math.round(4 * hours) / 4), Math.round(2 * Math.min(TOP_C, Math.max(LOW_C, value))) / 2];
  };
  const put = (number, event) => {
    const [hours, value] = place(event);
    const [before, after] = [rows[number - 1]?.[0] ?? -0.25, rows[number + 1]?.[0] ?? Infinity];
    const own = number === 0 ? 0 : Math.min(Math.max(hours, before + 0.25), after - 0.25);
    change(rows.map((row, k) => (k === number ? [own, value] : row)));
  };
  const grab = (event) => {
    const number = event.target.dataset.point;
    if (number != null) {
      held.current = { number: Number(number), span };
      area.current.setPointerCapture(event.pointerId);
    } else {
      const [hours, value] = place(event);
      if (!rows.some((row) => row[0] === hours)) change([...rows, [hours, value]].sort((a, b) => a[0] - b[0]));
    }
  };
  const drop = () => {
    held.current = null;
    change([...rows]);
  };
  return html`<svg ref=${area} class="profile" viewBox=${`0 0 ${WIDE} ${HIGH}`} preserveAspectRatio="none" role="img"
    aria-label=${`Targets of ${shown.length} points over ${lasts(HOUR * rows.at(-1)[0])}`}
    onPointerDown=${change && grab} onPointerMove=${change && ((event) => held.current && put(held.current.number, event))} onPointerUp=${change && drop}>
    ${[15, 20, 25, 30, 35].map((value) => html`<line key=${value} class="grid" x1="0" x2=${WIDE} y1=${y(value)} y2=${y(value)} />`)}
    <polyline points=${path} />
    ${at != null && html`<line class="at" x1=${x(at)} x2=${x(at)} y1="0" y2=${HIGH} />`}
    ${change && rows.map(([hours, value], k) => html`<path key=${k} class="point" data-point=${k} d=${`M${x(hours)} ${y(value)}h0`} />`)}
  </svg><p class="quiet">${LOW_C} to ${TOP_C} °C, over ${lasts(HOUR * span)}</p>`;
}

function Followed({ profile, order, mayOrder }) {
  const rows = profile.times_s.map((time, k) => [time / HOUR, profile.targets_c[k]]);
  const next = profile.times_s.findIndex((time) => time > profile.position_s);
  const end = profile.times_s.at(-1);
  const state = next < 0 ? `It is over; ${degrees(profile.targets_c.at(-1))} holds.`
    : profile.paused ? "It is paused." : `Next point: ${degrees(profile.targets_c[next])} in ${lasts(profile.times_s[next] - profile.position_s)}.`;
  return html`<p><strong>${profile.name}</strong>: ${lasts(profile.position_s)} of ${lasts(end)}. ${state}</p>
    <${Drawing} rows=${rows} linear=${profile.linear} at=${profile.position_s / HOUR} />
    ${mayOrder && html`<div class="row">
      ${next >= 0 && (profile.paused ? html`<${Do} key="resume" kind="plain" act=${() => order("resume_profile")}>Go on<//>` : html`<${Do} key="pause" act=${() => order("pause_profile")}>Pause<//>`)}
      ${next >= 0 && html`<${Do} act=${() => order("skip_profile")}>Skip to the next point<//>`}
      <${Do} act=${() => order("end_profile")}>End it<//>
    </div>`}`;
}

function Editor({ order }) {
  const [rows, setRows] = useState(EMPTY);
  const [name, setName] = useState("my profile");
  const [linear, setLinear] = useState(false);
  const [error, setError] = useState("");
  const set = (k, column, text) => setRows(rows.map((row, n) => (n === k ? row.map((old, c) => (c === column ? parseFloat(text) : old)) : row)));
  const load = async (event) => {
    const file = event.target.files[0];
    try {
      const found = rowsOf(await file.text());
      if (!found.length) throw new Error("the file has no row");
      setRows(found);
      setName(file.name.replace(/\.csv$/i, "").slice(0, 40));
      setError("");
    } catch (failed) {
      setError(failed.message);
    }
    event.target.value = "";
  };
  const seconds = () => rows.map(([hours]) => Math.round(HOUR * hours));
  const save = () => {
    const text = ["time_s,reference_c", ...rows.map(([, value], k) => `${seconds()[k]},${value}`)].join("\n");
    const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(new Blob([`${text}\n`])), download: `${name}.csv` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  const start = async () => {
    if (!rows.flat().every(Number.isFinite)) throw new Error("every row needs two numbers");
    await order("start_profile", { profile: { name, times_s: seconds(), targets_c: rows.map((row) => row[1]), linear } });
  };
  return html`<details><summary>Draw a new one, or load one</summary>
    <p class="quiet">Tap the drawing for a new point, drag points, or type them below. The last one holds until you end it.</p>
    <${Drawing} rows=${rows} linear=${linear} change=${setRows} />
    <table><thead><tr><th>after, hours</th><th>°C</th><th></th></tr></thead><tbody>
      ${rows.map(([hours, value], k) => html`<tr key=${k}>
        <td><input type="number" min="0" step="0.25" aria-label=${`hours of point ${k + 1}`} value=${hours} disabled=${k === 0} onChange=${(event) => set(k, 0, event.target.value)} /></td>
        <td><input type="number" step="0.5" aria-label=${`degrees of point ${k + 1}`} value=${value} onChange=${(event) => set(k, 1, event.target.value)} /></td>
        <td>${k > 0 && html`<button aria-label=${`remove point ${k + 1}`} onClick=${() => setRows(rows.filter((_, n) => n !== k))}>×</button>`}</td></tr>`)}
    </tbody></table>
    <div class="row"><button onClick=${() => setRows([...rows, [(rows.at(-1)[0] || 0) + 6, rows.at(-1)[1]]])}>Add a point</button>
      <label><input type="checkbox" checked=${linear} onChange=${(event) => setLinear(event.target.checked)} /> straight lines between points</label></div>
    <div class="row"><label>Name <input aria-label="name of the profile" maxlength="40" value=${name} onInput=${(event) => setName(event.target.value)} /></label>
      <label>Load CSV <input type="file" accept=".csv,text/csv" onChange=${load} /></label>
      <button onClick=${save}>Save as CSV</button></div>
    ${error && html`<p class="error" role="alert">${error}</p>`}
    <${Do} kind="plain" act=${start}>Start this profile<//>
  </details>`;
}

export function Profile({ view, me, done }) {
  const operation = view?.status?.operation;
  const mayOrder = me.may.includes("start_profile");
  if (!operation || (!operation.profile && !mayOrder)) return null;
  const order = (kind, more = {}) => call("POST", "/api/order", { do: kind, ...more }).then(done);
  return html`<section class="card" aria-label="Profile"><h2>Profile</h2>
    ${operation.profile && html`<${Followed} profile=${operation.profile} order=${order} mayOrder=${mayOrder} />
      ${operation.reference_c != null && html`<p class="quiet">${degrees(operation.reference_c)} set by hand holds instead.</p>`}`}
    ${mayOrder && html`<${Editor} order=${order} />`}
  </section>`;
}

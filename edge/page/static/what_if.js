// "What if": another heater, tighter walls, a weaker fan, as the twin that runs answers it.

import { html, useState } from "./ui.js";
import { call } from "./api.js";
import { Do } from "./parts.js";

// [key, label, unit, step, least, most]; what is empty stays as it is.
const CHANGES = [["heater_w", "Heater", "W", 5, 0, 20000], ["wall_factor", "Walls conduct times", "", 0.05, 0, 50], ["fan", "Fan, share of its air", "", 0.05, 0, 1]];
const PLACE = [["reach_c", "Target", "°C", 0.5, -20, 60], ["room_c", "Room", "°C", 0.5, -20, 60]];
const WALLS = [["wall", "Walls now", "polycarbonate:8mm"], ["walls_mm", "Walls then", "mm"]];

const rounded = (value) => (value == null ? "" : String(Math.round(2 * value) / 2));

export function WhatIf({ view }) {
  const [given, setGiven] = useState({});
  const [found, setFound] = useState(null);
  const tick = view?.status?.tick;
  const usual = { reach_c: rounded(tick?.reference_c), room_c: rounded(tick?.estimate.temp_ambient_c) };
  const value = (key) => given[key] ?? usual[key] ?? "";
  const set = (key) => (event) => setGiven({ ...given, [key]: event.target.value });
  const ask = async () => {
    const asked = new URLSearchParams();
    for (const [key] of [...CHANGES, ...PLACE, ...WALLS]) if (value(key) !== "") asked.set(key, value(key));
    if (tick?.reference_c != null) asked.set("hold_c", tick.reference_c);
    setGiven({ ...usual, ...given }); // what was asked stays, also when the rig goes on
    setFound(null);
    setFound(await call("GET", `/api/what-if?${asked}`));
  };
  const field = ([key, label, unit, step, least, most]) => html`<label key=${key}>${label}${unit && ` [${unit}]`}
    <input type="number" inputmode="decimal" step=${step} min=${least} max=${most} placeholder="as now" value=${value(key)} onInput=${set(key)} /></label>`;
  const differs = found?.rows.some((row) => row.changed);
  return html`<section class="card" aria-label="What if"><h2>What if</h2>
    <form onSubmit=${(event) => event.preventDefault()}>
      <div class="fields">${CHANGES.map(field)}${PLACE.map(field)}</div>
      <details><summary>Walls by their thickness</summary><div class="fields">
        ${WALLS.map(([key, label, hint]) => html`<label key=${key}>${label}<input placeholder=${hint} value=${value(key)} onInput=${set(key)} /></label>`)}
      </div></details>
      <div class="row"><${Do} kind="plain" act=${ask}>Ask the twin<//></div>
    </form>
    <div role="status">${found && html`<p class="reason">${found.verdict}</p>${found.limits.map((limit) => html`<p key=${limit}>${limit}</p>`)}
      <table><thead><tr><th>90 % intervals</th><th>now</th>${differs && html`<th>with the change</th>`}</tr></thead><tbody>
        ${found.rows.map((row) => html`<tr key=${row.row}><th scope="row">${row.row}</th><td>${row.now.text}</td>${differs && html`<td>${row.changed?.text}</td>`}</tr>`)}
      </tbody></table>
      <p class="quiet">${found.notes[0]}</p>
      <details><summary>What it rests on (${found.twin})</summary>${found.notes.slice(1).map((note) => html`<p key=${note}>${note}</p>`)}</details>`}</div>
  </section>`;
}

// One rig as the fleet knows it: its state, its last day, and orders to it.

import { html, useEffect, useMemo, useState } from "/ui.js";
import { call } from "/api.js";
import { Chart, LEGEND, columnsOf } from "/chart.js";
import { Do, clock, degrees, percent, seconds } from "/parts.js";
import { usePoll } from "./poll.js";
import { WORDS } from "./rig_list.js";

const DAY = 86400;
const EVERY = 60; // between two looks at the numbers [s]
const PAST = LEGEND.filter(([words]) => !/forecast|planned/.test(words));
const MODES = [["auto", "Automatic"], ["heat", "Heat only"], ["fan_only", "Fan only"], ["off", "Off"]];

function Now({ rig }) {
  const state = rig.state;
  const old = rig.standing === "offline";
  return html`<section class=${`now ${old ? "old" : ""}`} aria-label="Now">
    <div class="big"><span class="label">Air</span><strong>${degrees(rig.temp_air_c)}</strong><span class="quiet">${rig.last_utc ? `heard ${seconds(rig.utc - rig.last_utc)} ago` : "never heard"}</span></div>
    <div class="big"><span class="label">Reference</span><strong>${degrees(rig.reference_c)}</strong><span class="quiet">by ${String(state.controller ?? "–")}</span></div>
    <div><span class="label">Heater</span><strong>${percent(rig.heater_duty)}</strong></div>
    <div><span class="label">Mode</span><strong>${String(state.mode ?? "–")}</strong></div>
  </section>`;
}

function Course({ name }) {
  const [end, setEnd] = useState(() => Date.now() / 1000);
  const [course, setCourse] = useState(null);
  const [error, setError] = useState("");
  useEffect(() => {
    const asked = `from_utc=${end - DAY}&to_utc=${end}&points=720`;
    call("GET", `/api/rigs/${encodeURIComponent(name)}/course?${asked}`).then((found) => { setCourse(found.columns); setError(""); }, (failed) => setError(failed.message));
    const again = setTimeout(() => setEnd(Date.now() / 1000), 1000 * EVERY);
    return () => clearTimeout(again);
  }, [end]);
  const columns = useMemo(() => course && columnsOf(course, null), [course]);
  return html`<section class="card wide" aria-label="The last day"><h2>The last day</h2>
    ${error && html`<p class="error" role="alert">${error}</p>`}
    ${columns && html`<${Chart} columns=${columns} first=${end - DAY} last=${end} pick=${() => {}} pan=${() => {}} />`}
    <ul class="legend">${PAST.map(([words, colour, kind]) => html`<li key=${words}><i class=${`${kind} c${colour}`}></i>${words}</li>`)}</ul>
  </section>`;
}

function Orders({ rig, done }) {
  const [wish, setWish] = useState(null);
  if (rig.role === "view") return null;
  const order = (what, payload) => call("POST", `/api/rigs/${encodeURIComponent(rig.name)}/order`, { what, payload }).then(done);
  const target = wish ?? rig.reference_c ?? 24;
  const step = (by) => setWish(Math.round(10 * (target + by)) / 10);
  return html`<section class="card" aria-label="Orders"><h2>Orders</h2>
    <div class="row"><span class="label">Set point</span>
      <button aria-label="half a degree less" onClick=${() => step(-0.5)}>−</button>
      <output>${degrees(target)}</output>
      <button aria-label="half a degree more" onClick=${() => step(0.5)}>+</button>
      <${Do} kind="plain" disabled=${wish == null} act=${() => order("temperature", String(wish)).then(() => setWish(null))}>Set<//>
      <${Do} act=${() => order("follow_schedule", "PRESS").then(() => setWish(null))}>Follow the programme<//>
    </div>
    <div class="row" role="group" aria-label="Mode"><span class="label">Mode</span>
      ${MODES.map(([mode, words]) => html`<${Do} key=${mode} kind=${rig.state.mode === mode ? "on" : ""} act=${() => order("mode", mode)}>${words}<//>`)}
    </div>
    <div class="row">
      ${rig.standing === "tripped" && html`<${Do} act=${() => order("clear_trip", "PRESS")}>Clear the trip<//>`}
      ${rig.state.emergency_stop ? html`<${Do} act=${() => order("release_emergency_stop", "PRESS")}>Release the stop<//>` : null}
    </div>
    <p class="quiet">The rig checks every order, and its own safety decides.</p>
  </section>`;
}

function Stop({ rig, done }) {
  const stop = () => call("POST", `/api/rigs/${encodeURIComponent(rig.name)}/order`, { what: "emergency_stop", payload: "PRESS" }).then(done);
  return html`<section class="card" aria-label="Stop"><h2>Stop</h2><${Do} kind="stop" act=${stop}>STOP THIS RIG<//></section>`;
}

const rounded = (value) => (typeof value === "number" ? Number(value.toPrecision(4)) : String(value ?? "–"));

// A value of a twin is a number, or an object that says how it is known as well.
function Twin({ rig }) {
  const twin = rig.twin;
  const verdict = rig.drift.text ?? rig.drift.state;
  const values = Object.entries(twin?.effects ?? {}).flatMap(([effect, all]) => Object.entries(all ?? {}).map(([name, value]) => [effect, name, value?.value ?? value]));
  return html`<section class="card" aria-label="Twin"><h2>Its twin</h2>
    <p>${verdict ? String(verdict) : "It has said nothing of how well its twin agrees."}</p>
    ${!twin ? html`<p class="quiet">It has told no twin yet.</p>` : html`<p class="quiet">of bundle ${twin.bundle}, told ${clock(twin.utc, true)}</p>
      <table><thead><tr><th>effect</th><th>value</th></tr></thead><tbody>
      ${values.map(([effect, name, value]) => html`<tr key=${`${effect} ${name}`}><td>${effect} ${name}</td><td>${rounded(value)}</td></tr>`)}</tbody></table>`}
  </section>`;
}

function State({ rig }) {
  const rows = Object.entries(rig.state).filter(([, value]) => value !== null && value !== "");
  return html`<section class="card" aria-label="State"><h2>What it tells</h2>
    <details><summary>All of its state</summary><dl>${rows.map(([key, value]) => html`<dt key=${`${key}-name`}>${key}</dt><dd key=${key}>${String(value)}</dd>`)}</dl></details>
  </section>`;
}

export function Rig({ name }) {
  const { found, error, again } = usePoll(`/api/rigs/${encodeURIComponent(name)}`, 5);
  if (!found) return html`<p class=${error ? "error" : "quiet"} role=${error ? "alert" : null}>${error || "Loading …"}</p>`;
  const kind = ["offline", "tripped", "faulted"].includes(found.standing) ? "alarm" : "warn";
  return html`<main>
    <section class="wide"><h2>${found.name}</h2><p class="quiet">${[found.group, found.kind].filter(Boolean).join(" · ") || "no group"}</p>
      ${error && html`<p class="error" role="alert">${error}. What follows is of ${clock(found.utc)}.</p>`}
      ${found.standing !== "well" && html`<p class=${`trouble ${kind}`}>${WORDS[found.standing]}: ${found.why}</p>`}</section>
    <${Now} rig=${found} />
    <${Course} name=${name} />
    <${Orders} rig=${found} done=${again} />
    <${Twin} rig=${found} />
    <${State} rig=${found} />
    <${Stop} rig=${found} done=${again} />
  </main>`;
}

// Calibration of a sensor, step by step: bring it into a known state, say what is true, look, apply.

import { html, useState } from "./ui.js";
import { call } from "./api.js";
import { Do } from "./parts.js";

// [name, how to bring the sensor into a state whose value is known]
const KINDS = {
  temp_air: ["Air temperature", "Start maintenance, so that nothing heats meanwhile. Lay a thermometer that you trust beside the sensor. A sealed probe, and no other, may go into stirred ice water, 0 °C, or into water of at most 35 °C. Put it back dry before maintenance ends."],
  temp_ambient: ["Room temperature", "Lay a thermometer that you trust beside the sensor, without sun or draught."],
  rel_humidity: ["Humidity", "Close the sensor into a tight jar with a cup of wet table salt for 8 hours: 75 %. With wet magnesium chloride: 33 %. The salt touches nothing."],
  co2: ["CO2", "Bring the sensor into fresh air, far from people and chimneys: about 425 ppm."],
  light: ["Light", "Cover the sensor: 0. Under full light: 1."],
  soil_moisture: ["Soil moisture", "The clean dry probe in air: 0. Up to its line in soaked soil: 1."],
  tank_level: ["Tank level", "The empty tank: 0. The full one: 1."],
};
const DIGITS = { "°C": 2, "%": 1, ppm: 0, 1: 3 };

const amount = (value, unit) => (value == null ? "nothing good" : `${value.toFixed(DIGITS[unit] ?? 2)}${unit === "1" ? "" : `\u00a0${unit}`}`);
const date = (utc) => new Date(1000 * utc).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
const formula = ({ gain, offset }, unit) => `${gain.toPrecision(4)} × raw ${offset < 0 ? "−" : "+"} ${amount(Math.abs(offset), unit)}`;

function Wizard({ signal, state, hands, order }) {
  const [given, setGiven] = useState("");
  const { unit, points, following } = state;
  const say = (value) => amount(value, unit);
  const take = async () => {
    if (given === "" || !Number.isFinite(Number(given))) throw new Error("type the true value");
    await order("calibrate_point", { signal, true_value: Number(given) });
    setGiven("");
  };
  return html`<ol class="steps">
    <li>${KINDS[signal]?.[1]} Then wait until the reading stands still; ten minutes are seldom too long.
      ${signal === "temp_air" && !hands && html`<div class="row"><${Do} act=${() => order("maintenance", { minutes: 60 })}>Maintenance for 60 min<//></div>`}</li>
    <li>Say what is true. The daemon takes the mean of its readings of the last minute.
      ${points.length < 2 && html`<form class="row" onSubmit=${(event) => event.preventDefault()}>
        <label>True value ${unit === "1" ? "(0 to 1)" : `[${unit}]`} <input type="number" inputmode="decimal" step="any" value=${given} onInput=${(event) => setGiven(event.target.value)} /></label>
        <${Do} kind="plain" act=${take}>Take the ${points.length ? "second" : "first"} point<//></form>`}
      <div role="status">${points.map((point, k) => html`<p key=${point.utc}>Point ${k + 1}, ${date(point.utc)}: ${say(point.true_value)} is true. Raw readings: ${say(point.raw)} on average, noise ${say(point.noise)}.</p>`)}</div></li>
    <li>Look, and apply. One point moves the offset; a second one, far from the first, corrects the gain too.
      ${following && html`<p class="reason">The sensor reads ${say(state.reads)} now${state.reads != null && `, and will read ${say(state.will_read)}`}.</p>
        <p class="quiet">${formula(following, unit)} instead of ${formula(state, unit)}.</p>`}
      <div class="row">${points.length > 0 && html`<${Do} key="apply" kind="plain" disabled=${!following} act=${() => order("apply_calibration", { signal })}>Apply<//>
        <${Do} key="discard" act=${() => order("discard_points", { signal })}>Discard the points<//>`}
        ${state.since_utc != null && html`<${Do} key="reset" act=${() => order("reset_calibration", { signal })}>Back to the configured calibration<//>`}</div></li>
  </ol>`;
}

export function Calibration({ view, me, done }) {
  const [signal, setSignal] = useState("");
  const { calibration: states = {}, operation } = view?.status ?? {};
  if (!Object.keys(states).length) return null;
  const order = (kind, more) => call("POST", "/api/order", { do: kind, ...more }).then(done);
  const name = (each) => KINDS[each]?.[0] ?? each;
  return html`<section class="card" aria-label="Calibration"><h2>Calibration</h2>
    <table><thead><tr><th>sensor</th><th>reads</th><th>calibrated</th></tr></thead><tbody>
      ${Object.entries(states).map(([each, state]) => html`<tr key=${each}><th scope="row">${name(each)}</th><td>${amount(state.reads, state.unit)}</td>
        <td>${state.since_utc == null ? "as configured" : date(state.since_utc)}${state.points.length ? ", points wait" : ""}</td></tr>`)}
    </tbody></table>
    ${me.may.includes("calibrate_point") && html`<div class="row"><label>Calibrate <select value=${signal} onChange=${(event) => setSignal(event.target.value)}>
        <option value="">choose a sensor</option>${Object.keys(states).map((each) => html`<option key=${each} value=${each}>${name(each)}</option>`)}</select></label></div>
      ${states[signal] && html`<${Wizard} key=${signal} signal=${signal} state=${states[signal]} hands=${operation.maintenance_until_utc} order=${order} />`}`}
  </section>`;
}

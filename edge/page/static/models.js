// Models in use, the reports of diagnoses, and the history as a file.

import { html, useEffect, useRef, useState } from "./ui.js";
import { call } from "./api.js";
import { Do } from "./parts.js";

const LOOK_MS = 60000;
const POLL_MS = 1000;
const SHOWN = 5; // reports, until somebody asks for all
const WAIT_MAX = 600; // polls: an adoption proves its models on a slow computer

const order = (message) => call("POST", "/api/order", message);
const pause = () => new Promise((done) => setTimeout(done, POLL_MS));

// Gives an order that becomes a job of the daemon, and waits for the end of the job.
async function carryOut(message) {
  const { job } = await order(message);
  const question = message.do === "bundle" ? { do: "bundle", action: "status", job } : { do: message.do, job };
  for (let k = 0; k < WAIT_MAX; k += 1) {
    const found = await order(question);
    if (found.job_error) throw new Error(found.job_error);
    if (found.job_done) return;
    await pause();
  }
  throw new Error("It is not done yet. The events say how it ends.");
}

// A button that asks again before it acts. The focus goes to the question, and back with a no.
function Sure({ words, question, act }) {
  const [asked, setAsked] = useState(false);
  const first = useRef(null);
  const no = useRef(null);
  useEffect(() => no.current?.focus(), [asked]);
  const close = () => { setAsked(false); first.current.focus(); };
  return html`<button ref=${first} aria-expanded=${asked} onClick=${() => setAsked(!asked)}>${words}</button>
    ${asked && html`<div class="proposal" role="group" aria-label=${words}><p>${question}</p><div class="row">
      <${Do} kind="plain" act=${() => act().then(() => setAsked(false))}>Yes, ${words.toLowerCase()}<//>
      <button ref=${no} onClick=${close}>No</button></div></div>`}`;
}

// What a GET of the API says, asked again from time to time.
function useAnswer(path, isSoon = () => false) {
  const [state, setState] = useState({});
  const load = () => call("GET", path).then((found) => setState({ found }), (error) => setState({ found: state.found, error: error.message }));
  useEffect(() => { load(); }, []);
  useEffect(() => {
    const timer = setTimeout(load, isSoon(state.found) ? POLL_MS : LOOK_MS);
    return () => clearTimeout(timer);
  }, [state]);
  return { ...state, load };
}

const when = (time) => new Date(time).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });

function Bundle({ bundle, found, may, done }) {
  const { version } = bundle;
  const isActive = version === found.active;
  const role = isActive ? (found.on_probation ? "active, on trial" : "active") : version === found.rival || version === found.shadow ? "beside it, compared" : "";
  const question = `Make ${version} active? It takes the place of ${found.active} between two ticks and is on trial against it.`;
  return html`<li class=${isActive ? "in-use" : ""}><strong>${version}</strong> ${role && html`<em>${role}</em>`}
    ${bundle.problem ? html`<p class="error">It cannot be used: ${bundle.problem}</p>` : html`
      <p class="quiet">${bundle.name}, made ${when(bundle.created_utc)}. Models: ${bundle.models.join(", ")}${bundle.policies.length ? `; policies: ${bundle.policies.join(", ")}` : ""}.
        ${bundle.adopted_from ? ` The models of ${bundle.adopted_from} with an adopted twin.` : ""}
        ${bundle.effects.length ? ` Effects of the twin: ${bundle.effects.join(", ")}.` : ""}</p>
      ${may && !isActive && html`<${Sure} words="Activate" question=${question} act=${() => carryOut({ do: "bundle", action: "activate", version }).then(done)} />`}`}
  </li>`;
}

function Bundles({ answer, may }) {
  const { found, error, load } = answer;
  const back = () => carryOut({ do: "bundle", action: "rollback", version: found.ordered }).then(load);
  return html`<section class="card" aria-label="Models in use"><h2>Models in use</h2>
    ${error && html`<p class="error">${error}</p>`}
    ${found?.problems.map((problem) => html`<p key=${problem} class="error">${problem}</p>`)}
    ${found && !found.bundles.length && html`<p class="quiet">${found.looking ? "The daemon looks at its bundles …" : "No bundle is installed."}</p>`}
    <ul class="items">${found?.bundles.map((bundle) => html`<${Bundle} key=${bundle.version} bundle=${bundle} found=${found} may=${may} done=${load} />`)}</ul>
    ${found?.judgement && html`<p class="quiet">The trial ${found.judgement.verdict}: ${found.judgement.why}.</p>`}
    ${found?.back_to && html`<p>A roll back leads to ${found.back_to}.</p>
      ${may && html`<${Sure} words="Roll back" question=${`Leave ${found.ordered} and make ${found.back_to} active again?`} act=${back} />`}`}
  </section>`;
}

const HEADS = ["free runs [K]", "before", "after", "noise", "closed"];
const paragraphs = (lines) => lines.map((line) => html`<p key=${line}>${line}</p>`);

function Details({ name }) {
  const [state, setState] = useState({});
  useEffect(() => { call("GET", `/api/diagnoses/${name}`).then((found) => setState({ found }), (error) => setState({ error: error.message })); }, []);
  const { found, error } = state;
  if (!found) return error ? html`<p class="error">${error}</p>` : html`<p class="quiet">Loading …</p>`;
  const { experiment } = found;
  return html`${paragraphs(found.meaning)}
    <table><thead><tr>${HEADS.map((head) => html`<th key=${head}>${head}</th>`)}</tr></thead>
      <tbody>${found.figures.map((row) => html`<tr key=${row[0]}>${row.map((cell, k) => (k ? html`<td>${cell}</td>` : html`<th>${cell}</th>`))}</tr>`)}</tbody></table>
    ${found.effects.map((effect) => html`<p key=${effect.text}><strong>${effect.text}</strong> ${effect.evidence.join("; ")}</p>`)}
    ${found.where.length > 0 && html`<h3>Where it disagrees, by share of the squared error</h3>${paragraphs(found.where)}`}
    ${found.predicting.length > 0 && html`<h3>How well the new twin predicts</h3>${paragraphs(found.predicting)}`}
    ${found.against.length > 0 && html`<h3>Against adopting it</h3>${paragraphs(found.against)}`}
    ${experiment && html`<h3>The next experiment</h3>${paragraphs(experiment.why)}
      ${experiment.takes && html`<p>It takes ${experiment.takes}.</p>`}
      ${experiment.commands.length > 0 && html`<p>It runs the rig itself, so it is started on the rig's computer:</p><pre><code>${experiment.commands.join("\n")}</code></pre>`}`}`;
}

function Report({ report, may, active, done }) {
  const [open, setOpen] = useState(false);
  const adopt = (how) => () => carryOut({ do: "adopt", report: report.name, how }).then(done);
  return html`<li><details onToggle=${(event) => setOpen(event.target.open)}>
      <summary><time>${when(1000 * report.utc)}</time> ${report.headline || report.problem}</summary>
      ${open && !report.problem && html`<${Details} name=${report.name} />`}
      ${report.has_html && html`<p><a href=${`/api/diagnoses/${report.name}/report`} target="_blank" rel="noopener">The whole report, with pictures</a></p>`}</details>
    ${report.gap && html`<p class="quiet">${report.gap}</p>`}
    ${may && report.has_twin && html`<div class="row">
      <${Sure} words="Adopt" question=${`Run the twin of ${report.name} beside ${active ?? "the active bundle"}? It is compared and decides nothing. A bundle that runs beside it now makes room.`} act=${adopt("shadow")} />
      <${Sure} words="Adopt and activate" question=${`Let the twin of ${report.name} take the place of ${active ?? "the active bundle"}? It is on trial against it.`} act=${adopt("activate")} /></div>`}
  </li>`;
}

function Diagnoses({ answer, models, may }) {
  const { found, error } = answer;
  const [most, setMost] = useState(SHOWN);
  const done = () => Promise.all([answer.load(), models.load()]);
  const undo = models.found?.undo;
  return html`<section class="card" aria-label="Diagnosis"><h2>Diagnosis</h2>
    ${error && html`<p class="error">${error}</p>`}
    ${undo && html`<p>${undo} has an adopted twin and ${undo === models.found.ordered ? "is active" : "runs beside the active bundle"}.</p>
      ${may && html`<${Sure} words="Undo" question=${`Take ${undo} back? The bundle before goes on; the report stays.`} act=${() => carryOut({ do: "bundle", action: "undo-adoption", version: undo }).then(done)} />`}`}
    ${found && !found.reports.length && html`<p class="quiet">No report yet. The setting drift.diagnose lets the rig look for missing effects at night.</p>`}
    <ul class="items">${found?.reports.slice(0, most).map((report) => html`<${Report} key=${report.name} report=${report} may=${may} active=${models.found?.active} done=${done} />`)}</ul>
    ${found?.reports.length > most && html`<button onClick=${() => setMost(Infinity)}>All ${found.reports.length} reports</button>`}
  </section>`;
}

// A time as the browser's field has it, in local time.
const field = (ms) => new Date(ms - 60000 * new Date(ms).getTimezoneOffset()).toISOString().slice(0, 16);

// Until somebody says otherwise, the day before the newest tick; a demo's clock is not the browser's.
function Export({ newest }) {
  const end = newest == null ? Date.now() : 1000 * newest;
  const [first = field(end - 864e5), setFirst] = useState();
  const [last = field(end + 60000), setLast] = useState();
  const save = async () => {
    const asked = `from_utc=${Date.parse(first) / 1000}&to_utc=${Date.parse(last) / 1000}`;
    const answer = await fetch(`/api/export?${asked}`, { credentials: "same-origin" });
    if (!answer.ok) throw new Error((await answer.json()).error);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await answer.blob());
    link.download = `greenhouse_${first.slice(0, 10)}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), LOOK_MS);
  };
  return html`<section class="card" aria-label="Export"><h2>Export</h2>
    <p class="quiet">The ticks between two times as a run file, for <code>greenhouse twin diagnose</code> and <code>greenhouse replay</code>.</p>
    <div class="row"><label>From <input type="datetime-local" value=${first} onInput=${(event) => setFirst(event.target.value)} /></label>
      <label>To <input type="datetime-local" value=${last} onInput=${(event) => setLast(event.target.value)} /></label>
      <${Do} kind="plain" act=${save}>Save as CSV<//></div>
  </section>`;
}

export function ModelCards({ me, newest }) {
  const models = useAnswer("/api/models", (found) => found?.looking);
  const diagnoses = useAnswer("/api/diagnoses");
  const may = me.may.includes("bundle") && me.may.includes("adopt");
  return html`<${Bundles} answer=${models} may=${may} />
    <${Diagnoses} answer=${diagnoses} models=${models} may=${may} />
    <${Export} newest=${newest} />`;
}

// The fleet's page: all rigs, worst first, or the one that the address names, and the alarms.

import { html, render, useEffect, useErrorBoundary, useState } from "/ui.js";
import { call } from "/api.js";
import { Door, seconds } from "/parts.js";
import { Alarms } from "./alarms.js";
import { Rig } from "./rig.js";
import { RigList } from "./rig_list.js";

// What the address names: "#rig=NAME", "#alarms", else the list.
function usePlace() {
  const read = () => new URLSearchParams(location.hash.slice(1));
  const [place, setPlace] = useState(read);
  useEffect(() => {
    const look = () => { setPlace(read()); scrollTo(0, 0); };
    addEventListener("hashchange", look);
    return () => removeEventListener("hashchange", look);
  }, []);
  return place;
}

function Part({ children }) {
  const [error] = useErrorBoundary();
  return error ? html`<section class="card"><p class="error">This part of the page failed: ${error.message}</p></section>` : children;
}

// What makes the rest of the page less than true.
export function Health({ health }) {
  if (!health) return null;
  return html`<div aria-live="polite">
    ${!health.broker && html`<p class="trouble alarm">The broker does not answer this page: no order can be given, and what rigs do now is not known.</p>`}
    ${health.alarms_silent_s != null && html`<p class="trouble warn">Nobody watches for alarms: vmalert has been silent for ${seconds(health.alarms_silent_s)}.</p>`}
  </div>`;
}

function Fleet({ me }) {
  const place = usePlace();
  const [health, setHealth] = useState(null);
  const rig = place.get("rig");
  const shown = rig ? "" : place.has("alarms") ? "alarms" : "rigs";
  const leave = () => call("DELETE", "/api/session").then(() => location.reload());
  return html`
    <header><h1><a href="#">Greenhouses</a></h1><span class="quiet">${me.name}</span><button class="end" onClick=${leave}>Log out</button></header>
    <nav aria-label="Parts of the page">
      <a href="#" aria-current=${shown === "rigs" ? "page" : null}>Rigs</a>
      <a href="#alarms" aria-current=${shown === "alarms" ? "page" : null}>Alarms</a>
    </nav>
    <${Health} health=${health} />
    ${rig ? html`<${Part}><${Rig} key=${rig} name=${rig} /><//>`
      : shown === "alarms" ? html`<${Part}><${Alarms} tell=${setHealth} /><//>`
      : html`<${Part}><${RigList} tell=${setHealth} /><//>`}`;
}

function App() {
  const [me, setMe] = useState(null);
  const [reason, setReason] = useState(null);
  const look = () => call("GET", "/api/me").then(setMe, (error) => setReason(error.status === 401 ? "" : error.message));
  useEffect(() => { look(); }, []);
  if (me) return html`<${Fleet} me=${me} />`;
  return reason == null ? html`<p class="quiet">Loading …</p>`
    : html`<${Door} title="Greenhouses" reason=${reason} entered=${look}>Log in. <code>greenhouse fleet user add</code> makes a name and a password.<//>`;
}

render(html`<${App} />`, document.getElementById("app"));

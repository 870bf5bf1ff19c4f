// The fleet's page: all rigs, worst first, or the one that the address names, the alarms, and bundles on their way.

import { html, render, useEffect, useErrorBoundary, useState } from "/ui.js";
import { call } from "/api.js";
import { Door, seconds } from "/parts.js";
import { Alarms } from "./alarms.js";
import { Rig } from "./rig.js";
import { RigList } from "./rig_list.js";
import { Rollouts } from "./rollouts.js";

// What the address names: "#rig=NAME", "#alarms", "#bundles", else the list.
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
export function Health({ health, shown }) {
  if (!health) return null;
  return html`<div aria-live="polite">
    ${!health.broker && html`<p class="trouble alarm">The broker does not answer this page: no order can be given, and what rigs do now is not known.</p>`}
    ${health.alarms_silent_s != null && html`<p class="trouble warn">Nobody watches for alarms: vmalert has been silent for ${seconds(health.alarms_silent_s)}.</p>`}
    ${shown !== "bundles" && health.held.map((number) => html`<p key=${number} class="trouble warn">Rollout ${number} is held and waits for a person: <a href="#bundles">see Bundles</a>.</p>`)}
  </div>`;
}

const PARTS = [["", "Rigs", RigList], ["alarms", "Alarms", Alarms], ["bundles", "Bundles", Rollouts]];

function Fleet({ me }) {
  const place = usePlace();
  const [health, setHealth] = useState(null);
  const rig = place.get("rig");
  const shown = rig ? null : PARTS.map(([part]) => part).find((part) => part && place.has(part)) ?? "";
  const Shown = PARTS.find(([part]) => part === shown)?.[2];
  const leave = () => call("DELETE", "/api/session").then(() => location.reload());
  return html`
    <header><h1><a href="#">Greenhouses</a></h1><span class="quiet">${me.name}</span><button class="end" onClick=${leave}>Log out</button></header>
    <nav aria-label="Parts of the page">
      ${PARTS.map(([part, words]) => html`<a key=${part} href=${`#${part}`} aria-current=${shown === part ? "page" : null}>${words}</a>`)}
    </nav>
    <${Health} health=${health} shown=${shown} />
    <${Part} key=${rig ? `rig ${rig}` : shown}>${rig ? html`<${Rig} name=${rig} />` : html`<${Shown} tell=${setHealth} />`}<//>`;
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

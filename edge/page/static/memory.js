// What was decided and noted: the facts that a language model is given beside a request in words.

import { html, useEffect, useState } from "./ui.js";
import { call } from "./api.js";
import { Do } from "./parts.js";

const SHOWN = 8; // at first; there may be a thousand
const LONGEST = 500;
const order = (kind, more) => call("POST", "/api/order", { do: kind, ...more });
const date = (utc) => new Date(1000 * utc).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });

function Row({ fact, load }) {
  const [text, setText] = useState(null); // while it is edited
  const save = async () => {
    await order("remember", { id: fact.id, text });
    setText(null);
    await load();
  };
  const origin = `${date(fact.utc)}, ${fact.kind}${fact.by ? ` by ${fact.by}` : ""}${fact.edited_utc ? ", edited" : ""}`;
  if (text == null) {
    return html`<li><time>${origin}</time><span>${fact.text}</span>
      <div><button aria-label=${`Edit ${fact.text}`} onClick=${() => setText(fact.text)}>Edit</button></div></li>`;
  }
  return html`<li><time>${origin}</time><input aria-label="Text" maxlength=${LONGEST} value=${text} onInput=${(event) => setText(event.target.value)} />
    <div class="row"><${Do} kind="plain" disabled=${!text.trim()} act=${save}>Save<//>
      <${Do} act=${() => order("forget", { id: fact.id }).then(load)}>Forget<//><button onClick=${() => setText(null)}>Leave it</button></div></li>`;
}

export function Memory({ me, news }) {
  const [found, setFound] = useState(null);
  const [error, setError] = useState("");
  const [note, setNote] = useState("");
  const [all, setAll] = useState(false);
  const may = me.may.includes("memory");
  const load = () => order("memory").then((answer) => { setFound(answer); setError(""); }, (failed) => setError(failed.message));
  useEffect(() => { if (may) load(); }, [news]);
  if (!may) return null;
  const add = async () => {
    await order("remember", { text: note });
    setNote("");
    await load();
  };
  const facts = found?.facts ?? [];
  return html`<section class="card" aria-label="Memory"><h2>Memory</h2>
    <p class="quiet">${found?.tokens === 0 ? "The language model is given none of this." : "The newest and the fitting ones go to the language model with a request. They set nothing by themselves."}</p>
    ${error && html`<p class="error">${error}</p>`}
    <div class="row"><input aria-label="A note" placeholder="no fan between 22:00 and 07:00" maxlength=${LONGEST} value=${note} onInput=${(event) => setNote(event.target.value)} />
      <${Do} disabled=${!note.trim()} act=${add}>Note it<//></div>
    <ul class="events">${facts.slice(0, all ? facts.length : SHOWN).map((fact) => html`<${Row} key=${fact.id} fact=${fact} load=${load} />`)}</ul>
    ${found && !facts.length && html`<p class="quiet">Nothing is remembered yet.</p>`}
    ${!all && facts.length > SHOWN && html`<button onClick=${() => setAll(true)}>Show all ${facts.length}</button>`}
  </section>`;
}

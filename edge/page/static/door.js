// Where somebody comes in who has no session.

import { html, useState } from "./ui.js";
import { call } from "./api.js";

// reason : why there is no session, "" for none; entered() : called after a login; children : how to come in
export function Door({ title = "Greenhouse", reason, entered, children }) {
  const [name, setName] = useState("");
  const [password, setPassword] = useState("");
  const [error, setError] = useState(reason);
  const enter = (event) => {
    event.preventDefault();
    call("POST", "/api/session", { name, password }).then(entered, (failed) => setError(failed.message));
  };
  return html`<main class="door"><section class="card"><h1>${title}</h1>
    <p>${children}</p>
    ${error && html`<p class="error" role="alert">${error}</p>`}
    <form onSubmit=${enter}>
      <label>Name <input autocomplete="username" value=${name} onInput=${(event) => setName(event.target.value)} /></label>
      <label>Password <input type="password" autocomplete="current-password" value=${password} onInput=${(event) => setPassword(event.target.value)} /></label>
      <button class="plain">Log in</button>
    </form></section></main>`;
}

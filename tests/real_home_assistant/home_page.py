"""A page of Home Assistant in a browser: entered by a token, its cards counted."""

import json

from selenium.webdriver.remote.webdriver import WebDriver

from tests.support.broker import wait_for

# A Home Assistant page is shadow trees within shadow trees, which no selector enters.
COUNT = """
const count = (node, name) => {
  let found = node.localName === name ? 1 : 0;
  for (const child of [...(node.shadowRoot?.children ?? []), ...node.children]) found += count(child, name);
  return found;
};
return count(document, arguments[0]);
"""


def log_in(driver: WebDriver, url: str, token: str) -> None:
    """Give Home Assistant's page a token, where it looks for one."""
    tokens = {
        "access_token": token,
        "token_type": "Bearer",
        "expires_in": 86400,
        "hassUrl": url,
        "clientId": f"{url}/",
        "expires": 9e15,
        "refresh_token": "",
    }
    driver.get(f"{url}/manifest.json")  # of the same origin
    driver.execute_script("localStorage.setItem('hassTokens', arguments[0])", json.dumps(tokens))
    driver.execute_script("localStorage.setItem('dockedSidebar', JSON.stringify('always_hidden'))")


def keep_port(driver: WebDriver, url: str) -> None:
    """Confirm the port, which newer versions ask for in a dialog; an older one refuses the command."""
    driver.get(url)
    home = "document.querySelector('home-assistant')"
    wait_for(lambda: driver.execute_script(f"return {home}?.hass?.connected === true"), "the page", 60.0)
    driver.execute_script(
        f"return {home}.hass.callWS({{type: 'http/config/promote'}}).then(() => 1, () => 0)"
    )


def count(driver: WebDriver, element: str) -> int:
    """Return how many elements of this name the page has, in shadow trees too."""
    return int(driver.execute_script(COUNT, element))

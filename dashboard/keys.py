"""Keys of the review, in the order in which they were pressed.

Streamlit acts on a key's button as it is drawn when the key arrives. A key that is pressed while the page is still
being drawn anew would go to the finding before, or to no button at all. So keys wait until the page was drawn after the
one before, and each is then acted on by the button that has it. Where a refusal appears, the keys behind
it are forgotten: they were meant for what did not happen.
"""

from __future__ import annotations

from urllib.parse import unquote

import streamlit as st

_DRAWN = "keys_drawn"
# `data-has-shortcut` and `aria-label="Shortcut …"` are how Streamlit marks a button's key.
KEYS_IN_ORDER = """<script>
{
  const MOST = 12, LATE = 15000;
  const KEYS = ['j', 'k', 'u', 'w', 'p', 's', 'n', 'enter', 'escape'];
  const OWN = 'canvas, .st-key-decisions, .st-key-previous, .st-key-next, [data-testid="stDataFrame"]';
  const FIELDS = 'input, textarea, select, [contenteditable="true"], [role="dialog"], [role="listbox"]';
  const REFUSED = '[data-testid="stAlertContentError"], [data-testid="stAlertContentWarning"]';
  const waiting = [];
  let before = null, clicked = 0, said = '';
  const here = () => document.querySelector('[data-drawn]');
  const drawn = () => here()?.dataset.drawn;
  const refusals = () => [...document.querySelectorAll(REFUSED)].map(e => e.innerText).join();
  const buttonOf = (key) => [...document.querySelectorAll('[data-has-shortcut="true"] [aria-label]')]
      .find(mark => mark.getAttribute('aria-label').toLowerCase() === `shortcut ${key.replace('escape', 'esc')}`)
      ?.closest('button');
  const busy = () => before === drawn() || document.querySelector('[data-stale="true"]')
      || !document.querySelector('[data-testid="stApp"][data-test-script-state="notRunning"]');
  const act = () => {
    const late = before !== null && performance.now() - clicked > LATE;
    if (!here() || late) { waiting.length = 0; before = null; }
    else if (!busy()) {
      before = null;
      if (refusals() && refusals() !== said) waiting.length = 0;
      const button = waiting.length ? buttonOf(waiting.shift()) : null;
      if (button && !button.disabled) {
        [before, clicked, said] = [drawn(), performance.now(), refusals()];
        button.click();
      }
    }
    if (waiting.length || before !== null) setTimeout(act, 20);
  };
  window.addEventListener('keydown', (event) => {
    const key = event.key?.toLowerCase(), at = event.target;
    if (!here() || event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) return;
    if (!KEYS.includes(key) || at.closest?.(FIELDS)) return;
    if (key === 'enter' && at !== document.body && !at.closest?.(OWN)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (waiting.length >= MOST || (event.repeat && waiting.length)) return;
    const idle = !waiting.length && before === null;
    if (idle) said = refusals();
    waiting.push(key);
    if (idle) act();
  }, true);
  // Enter on another button or link opens that, and records nothing besides.
  document.body.addEventListener('keydown', (event) => {
    const other = event.target.closest?.('button, a') && !event.target.closest(OWN);
    if (event.key === 'Enter' && here() && other) event.stopPropagation();
  });
}
</script>"""


NAME_KEY = """<script>
{
  window.addEventListener('change', (event) => {
    if (event.target.closest?.('.st-key-who'))
      document.cookie = `flushline_name=${encodeURIComponent(event.target.value)}; path=/; SameSite=Strict`;
  }, true);
  window.addEventListener('keydown', (event) => {
    const field = document.querySelector('.st-key-who input');
    if (!field || event.key?.toLowerCase() !== 'y' || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest?.('input, textarea, select, [contenteditable="true"], [role="listbox"]')) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    field.focus();
  }, true);
}
</script>"""
"""Has the key y lead to the field for one's name, on every page that has one; the browser keeps it until it ends."""


def name_of_browser() -> str:
    """The name that was given in this browser before a page was loaded anew; "" where there is none."""
    try:
        return unquote(str(st.context.cookies.get("flushline_name") or ""))
    except Exception:  # Streamlit raises kinds of its own outside a browser session
        return ""


def keep_order() -> None:
    """Have the browser act on this page's keys one after the other, see `page_end`; called when all else is drawn."""
    drawn = st.session_state[_DRAWN] = st.session_state.get(_DRAWN, 0) + 1
    st.html(f'<i data-drawn="{drawn}" hidden></i>')

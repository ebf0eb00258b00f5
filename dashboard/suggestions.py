"""What a field offers while somebody types: comments of before, and names of tables and columns in SQL.

Streamlit's fields offer nothing themselves. The browser's own list serves for comments; for SQL the names that begin
like the word before the cursor stand below the field, and Tab takes the first.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence

import streamlit as st

from storage.review import Review
from storage.templates import rendered

_MOST_COMMENTS = 12
_LIST = "flushline-comments"
_COMMENTS = """<script>
if (!window.flushlineComments) {
  window.flushlineComments = true;
  document.addEventListener('focusin', (event) => {
    if (event.target.matches?.('[class*="st-key-comment-"] input')) event.target.setAttribute('list', 'LIST');
  });
}
</script>"""
_SQL = """<script>
if (!window.flushlineNames) {
  window.flushlineNames = NAMES;
  const MOST = 8;
  const box = document.createElement('div');
  box.className = 'flushline-names';
  box.style.cssText = 'position:fixed;z-index:1000;display:none;gap:4px;padding:4px;border-radius:6px;'
      + 'background:#31333f;color:#fff;font:13px monospace;flex-wrap:wrap;';
  document.body.append(box);
  const fieldOf = (e) => e.target.matches?.('.st-key-sql textarea') ? e.target : null;
  let shown = [];
  const hide = () => { shown = []; box.style.display = 'none'; };
  const words = (field) => {
    const [, table, begun] = /(?:(\\w+)\\.)?(\\w*)$/.exec(field.value.slice(0, field.selectionStart));
    const names = window.flushlineNames, own = table && names[table.toLowerCase()];
    if (!own && !begun) return [];
    const all = own ?? [...Object.keys(names), ...new Set(Object.values(names).flat())];
    return all.filter(n => n.startsWith(begun.toLowerCase()) && n !== begun.toLowerCase()).slice(0, MOST)
        .map(n => [n, n.slice(begun.length)]);
  };
  const take = (field, rest) => { field.focus(); document.execCommand('insertText', false, rest); hide(); };
  const show = (field) => {
    shown = field.selectionStart === field.selectionEnd ? words(field) : [];
    if (!shown.length) return hide();
    const place = field.getBoundingClientRect();
    box.style.left = `${place.left}px`;
    box.style.top = `${place.bottom + 2}px`;
    box.style.maxWidth = `${place.width}px`;
    box.style.display = 'flex';
    box.replaceChildren(...shown.map(([name, rest], k) => {
      const one = document.createElement('span');
      one.textContent = k ? name : `${name} ⇥`;
      one.style.cssText = `cursor:pointer;padding:1px 6px;border-radius:4px;background:${k ? '#4a4d5a' : '#0072B2'}`;
      one.onmousedown = (event) => { event.preventDefault(); take(field, rest); };
      return one;
    }));
  };
  document.addEventListener('input', (event) => { const field = fieldOf(event); if (field) show(field); });
  document.addEventListener('keydown', (event) => {
    const field = fieldOf(event);
    if (!field || !shown.length) return;
    if (event.key === 'Tab' && !event.shiftKey) { event.preventDefault(); take(field, shown[0][1]); }
    else if (['Escape', 'ArrowLeft', 'ArrowRight', 'ArrowUp', 'ArrowDown'].includes(event.key)) hide();
  }, true);
  document.addEventListener('focusout', (event) => { if (fieldOf(event)) hide(); });
}
</script>"""


def suggest_comments(review: Review) -> None:
    """Offer what was said most of earlier decisions; called beside the field of a comment."""
    said = Counter(entry.comment for entry in review.entries if entry.disposition and entry.comment)
    st.html(_COMMENTS.replace("LIST", _LIST), unsafe_allow_javascript=True)
    comments = [comment for comment, __ in said.most_common(_MOST_COMMENTS)]
    st.html(rendered("dashboard", "comments.html", name=_LIST, comments=comments))


def suggest_names(columns: Mapping[str, Sequence[str]]) -> None:
    """Offer names in the field of the query.

    Parameters
    ----------
    columns : mapping of str to sequence of str
        Of each table and view.
    """
    names = json.dumps({table: list(own) for table, own in columns.items()})
    st.html(_SQL.replace("NAMES", names), unsafe_allow_javascript=True)

"""Who sits in front of the page and what they may do.

With an `[auth]` section in Streamlit's secrets people log in through OIDC, and the roles of the settings file decide.
Without it nobody can be told apart, the server listens on this machine only, and whoever sits there may review under
the name they give.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import streamlit as st

from dashboard.settings import RolesModel

Role = Literal["nobody", "viewer", "reviewer"]


@dataclass(frozen=True)
class Person:
    """The person at the browser.

    Attributes
    ----------
    name : str
        E-mail address; empty where nobody logs in.
    role : "nobody", "viewer" or "reviewer"
    verified : bool
        Whether a log-in vouches for the name.
    """

    name: str
    role: Role
    verified: bool

    @property
    def may_review(self) -> bool:
        """Whether they may dispose and sign off."""
        return self.role == "reviewer"


def login_configured() -> bool:
    """Whether Streamlit's secrets name an identity provider."""
    try:
        return "auth" in st.secrets
    except Exception:  # no secrets file, or one that is not TOML: Streamlit raises kinds of its own
        return False


def current_person(roles: RolesModel) -> Person:
    """Who it is."""
    if not login_configured():
        return Person("", "reviewer", False)
    if not st.user.is_logged_in:
        return Person("", "nobody", False)
    claims = st.user.to_dict()
    # An address that the provider did not verify is a claim, not an identity.
    address = str(claims.get("email") or "") if claims.get("email_verified", True) else ""
    name = address or str(claims.get("sub") or "")
    return Person(name, role_of(name, roles), True)


def role_of(name: str, roles: RolesModel) -> Role:
    """The role of a person who logged in."""
    if _listed(name, roles.reviewers):
        return "reviewer"
    return "viewer" if _listed(name, roles.viewers) else "nobody"


def _listed(name: str, names: tuple[str, ...]) -> bool:
    return bool(name) and ("*" in names or name.casefold() in {listed.casefold() for listed in names})

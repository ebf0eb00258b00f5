"""Who sits in front of the page and what they may do.

With an `[auth]` section in Streamlit's secrets people log in through OIDC, and the roles of the settings file decide.
Without it nobody can be distinguished, the server listens on this machine only, and whoever sits there may review under
the name they give.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import streamlit as st

from dashboard.log_outs import LogOuts
from dashboard.settings import RolesModel

Role = Literal["nobody", "viewer", "reviewer"]


@dataclass(frozen=True)
class Person:
    """The person at the browser."""

    name: str
    """E-mail address; empty where nobody logs in."""
    role: Role
    verified: bool
    """Whether a log-in vouches for the name."""
    design_authority: bool = True
    """Whether a reviewer may also let parts pass that are not as drawn."""
    signs_as: str = "reviewer"
    """The role that their signatures name."""

    @property
    def may_review(self) -> bool:
        """Whether they may dispose and sign off."""
        return self.role == "reviewer"

    @property
    def may_accept(self) -> bool:
        """Whether they may decide "use as is" and "repair"."""
        return self.may_review and self.design_authority


def login_configured() -> bool:
    """Whether Streamlit's secrets name an identity provider."""
    try:
        return "auth" in st.secrets
    except Exception:  # no secrets file, or one that is not TOML: Streamlit raises kinds of its own
        return False


def current_person(roles: RolesModel, root: Path) -> Person:
    """Who it is.

    Parameters
    ----------
    root : Path
        The store's folder, which knows who logged out.
    """
    if not login_configured():
        return Person("", "reviewer", False, signs_as=roles.titles.get("*", "reviewer"))
    if not st.user.is_logged_in:
        return Person("", "nobody", False)
    claims: Mapping[str, object] = st.user.to_dict()
    if LogOuts(root).ended(claims):
        return Person("", "nobody", False)
    name = name_of(claims)
    design_authority = is_design_authority(name, claims, roles)
    return Person(name, role_of(name, claims, roles), True, design_authority, signing_role(name, claims, roles))


def name_of(claims: Mapping[str, object]) -> str:
    """The address that the provider verified, else its subject.

    An address that is not verified is a claim, not an identity; only the boolean true verifies it, not the text "true".
    """
    address = str(claims.get("email") or "") if claims.get("email_verified") is True else ""
    return address or str(claims.get("sub") or "")


def log_out(root: Path) -> None:
    """End this log-in: copies of its cookie are worth nothing from now on."""
    LogOuts(root).end(st.user.to_dict())
    st.logout()


def role_of(name: str, claims: Mapping[str, object], roles: RolesModel) -> Role:
    """The role of a person who logged in, by their name or by the claim that the settings name."""
    values = _values(claims, roles)
    if _listed(name, roles.reviewers) or values & set(roles.reviewer_values):
        return "reviewer"
    return "viewer" if _listed(name, roles.viewers) or values & set(roles.viewer_values) else "nobody"


def is_design_authority(name: str, claims: Mapping[str, object], roles: RolesModel) -> bool:
    """Whether a person who logged in is the design authority; everyone is where the settings name none."""
    if not (roles.design_authority or roles.design_authority_values):
        return True
    return _listed(name, roles.design_authority) or bool(_values(claims, roles) & set(roles.design_authority_values))


def signing_role(name: str, claims: Mapping[str, object], roles: RolesModel) -> str:
    """The role that the signatures of a person who logged in name: by the settings, else what they may do."""
    by_name = {listed.casefold(): title for listed, title in roles.titles.items()}
    if title := by_name.get(name.casefold()) or by_name.get("*"):
        return title
    named = roles.design_authority or roles.design_authority_values
    return "design authority" if named and is_design_authority(name, claims, roles) else "reviewer"


def _values(claims: Mapping[str, object], roles: RolesModel) -> set[str]:
    """What the claim that the settings name says of a person."""
    found = claims.get(roles.claim) if roles.claim else None
    return {value for value in (found if isinstance(found, list | tuple) else [found]) if isinstance(value, str)}


def _listed(name: str, names: tuple[str, ...]) -> bool:
    return bool(name) and ("*" in names or name.casefold() in {listed.casefold() for listed in names})

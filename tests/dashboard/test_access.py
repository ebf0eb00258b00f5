"""Names and roles from what an identity provider says."""

from __future__ import annotations

from pathlib import Path

import pytest

from dashboard import log_outs
from dashboard.access import Person, name_of, role_of, signing_role
from dashboard.log_outs import LogOuts
from dashboard.settings import RolesModel
from dashboard.signing import confirmed

ADDRESS = "m.weber@example.com"


@pytest.mark.parametrize("verified", [None, False, "false", "true", 1, "yes"])
def test_only_the_boolean_true_verifies_an_address(verified: object) -> None:
    assert name_of({"sub": "7", "email": ADDRESS, "email_verified": verified}) == "7"
    assert name_of({"sub": "7", "email": ADDRESS}) == "7"
    assert name_of({"sub": "7", "email": ADDRESS, "email_verified": True}) == ADDRESS


@pytest.mark.parametrize(
    ("claims", "role"),
    [
        ({"groups": ["hall-7"]}, "viewer"),
        ({"groups": ["hall-7", "quality"]}, "reviewer"),
        ({"groups": "quality"}, "reviewer"),
        ({"groups": ["canteen", 7, None]}, "nobody"),
        ({"groups": None}, "nobody"),
        ({"roles": ["quality"]}, "nobody"),
    ],
)
def test_a_role_by_a_claim(claims: dict[str, object], role: str) -> None:
    roles = RolesModel(viewers=(), claim="groups", reviewer_values=("quality",), viewer_values=("hall-7",))
    assert role_of("7", claims, roles) == role


def test_values_need_a_claim() -> None:
    with pytest.raises(ValueError, match="claim"):
        RolesModel(reviewer_values=("quality",))


def test_a_signature_names_its_role_and_a_log_in_is_confirmed() -> None:
    roles = RolesModel(design_authority=("k.ito@example.com",), titles={"M.Weber@example.com": "quality inspector"})
    assert [signing_role(name, {}, roles) for name in (ADDRESS, "k.ito@example.com", "j.doe@example.com")] == [
        "quality inspector", "design authority", "reviewer",
    ]  # fmt: skip
    assert signing_role(ADDRESS, {}, RolesModel()) == "reviewer"
    person = Person(ADDRESS, "reviewer", True)
    assert [confirmed(person, typed) for typed in ("", "m.weber", " M.Weber@example.com ")] == [
        None, None, "log-in, name typed",
    ]  # fmt: skip
    assert confirmed(Person("", "reviewer", False), "") == "given name"


def test_a_log_out_is_known_to_other_servers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    claims = {"iss": "a", "sub": "7", "iat": 1, "nonce": "n"}
    LogOuts(tmp_path).end(claims)
    monkeypatch.setattr(log_outs, "_ended_here", set())  # as in another process
    assert LogOuts(tmp_path).ended(claims)
    assert not LogOuts(tmp_path).ended(claims | {"nonce": "another log-in"})
    LogOuts(tmp_path).path.write_text("{")
    assert LogOuts(tmp_path).ended(claims | {"nonce": "another log-in"})  # nobody can tell

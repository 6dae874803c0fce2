"""Keys: who can read them, what they say, what is never overwritten."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID
from typer.testing import CliRunner

from rbtrg_robot.access import certificates
from rbtrg_robot.access.certificates import (
    KeysError,
    add,
    certificate_of,
    check,
    lies_open,
    listed,
    make_authority,
    members,
    remove,
)
from rbtrg_robot.access.identity import CA, CERTIFICATE, KEY, ROBOT, keys_dir
from rbtrg_robot.access.serve import security
from rbtrg_robot.cli.main import app
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.topics import Role


@pytest.fixture
def base(tmp_path: Path) -> Path:
    """An authority and a robot."""
    folder = tmp_path / "keys"
    make_authority(folder, 30)
    return folder


def purposes(folder: Path) -> list[x509.ObjectIdentifier]:
    return list(certificate_of(folder).extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)


def test_nobody_else_reads_what_lies_there(base: Path) -> None:
    add(base, "anna", Role.OPERATOR, 5)
    modes = {p.relative_to(base): p.stat().st_mode & 0o777 for p in (base, *base.rglob("*"))}
    assert {modes[p] for p in modes if (base / p).is_dir()} == {0o700}
    assert {modes[p] for p in modes if not (base / p).is_dir()} == {0o600}
    assert len(modes) == 4 + 2 + 4 + 3
    key = (base / "anna" / KEY).read_bytes()
    assert key.startswith(b"-----BEGIN PRIVATE KEY-----")  # PKCS#8
    loaded = load_pem_private_key(key, None)
    assert isinstance(loaded, ec.EllipticCurvePrivateKey)
    assert loaded.curve.name == "secp256r1"
    assert loaded.public_key() == certificate_of(base / "anna").public_key()


def test_a_certificate_is_signed_and_serves_one_end_only(base: Path) -> None:
    folder = add(base, "anna", Role.OBSERVER, 5)
    authority = certificate_of(base / "ca")
    for made in (folder, base / "robot"):
        certificate_of(made).verify_directly_issued_by(authority)
        assert (made / CA).read_bytes() == (base / "ca" / CERTIFICATE).read_bytes()
    assert purposes(folder) == [ExtendedKeyUsageOID.CLIENT_AUTH]
    assert purposes(base / "robot") == [ExtendedKeyUsageOID.SERVER_AUTH]
    left = certificate_of(folder).not_valid_after_utc - datetime.now(UTC)
    assert timedelta(days=4.9) < left <= timedelta(days=5)


def test_the_list_names_role_person_and_number(base: Path) -> None:
    add(base, "anna", Role.OPERATOR, 5)
    add(base, "bob", Role.OBSERVER, 5)
    for name in ("anna", "bob"):
        assert certificates.common_name(certificate_of(base / name)) in listed(base / "robot")
    found = members(base / "robot")
    assert [x.split(":")[:2] for x in found[Role.OPERATOR]] == [["operator", "anna"]]
    assert [x.split(":")[:2] for x in found[Role.OBSERVER]] == [["observer", "bob"]]
    remove(base, "anna")
    assert members(base / "robot")[Role.OPERATOR] == []
    with pytest.raises(KeysError, match="not on the list"):
        remove(base, "anna")


def test_an_old_certificate_does_not_count_beside_the_new_one(base: Path) -> None:
    add(base, "anna", Role.OPERATOR, 5)
    old = certificates.common_name(certificate_of(base / "anna"))
    add(base, "anna", Role.OPERATOR, 5, force=True)
    new = certificates.common_name(certificate_of(base / "anna"))
    assert listed(base / "robot") == [new] != [old]


def test_nothing_is_overwritten_unless_forced(base: Path) -> None:
    add(base, "anna", Role.OPERATOR, 5)
    before = {p: p.read_bytes() for p in base.rglob("*") if p.is_file()}
    with pytest.raises(KeysError, match="--force"):
        make_authority(base, 5)
    with pytest.raises(KeysError, match="--force"):
        add(base, "anna", Role.OBSERVER, 5)
    assert {p: p.read_bytes() for p in base.rglob("*") if p.is_file()} == before
    make_authority(base, 5, force=True)
    assert listed(base / "robot") == []
    assert (base / "robot" / CA).read_bytes() != before[base / "robot" / CA]


@pytest.mark.parametrize("name", ["", "ca", "robot", "../anna", "a b", "a:b", "*", "x" * 33, "anna\n"])
def test_a_name_is_a_plain_word(base: Path, name: str) -> None:
    with pytest.raises(KeysError, match="cannot be a name"):
        add(base, name, Role.OPERATOR, 5)


@pytest.mark.parametrize("line", ["*", "operator:*:00000000", "root:anna:00000000", "operator:anna", ""])
def test_a_broken_list_lets_nobody_in(base: Path, line: str) -> None:
    (base / "robot" / certificates.ACCESS).write_text(f"# people\n{line}\n")
    if line:
        with pytest.raises(KeysError, match="role:name:number"):
            check(base / "robot")
    else:
        check(base / "robot")
        assert listed(base / "robot") == []


def test_the_robot_does_not_serve_with_bad_keys(base: Path, tmp_path: Path) -> None:
    def serve(folder: Path) -> None:
        security(load(network={"listen": ["tls/192.0.2.1:7448"], "keys": str(folder)}))

    serve(base / "robot")
    with pytest.raises(KeysError, match="keys init"):
        serve(tmp_path / "nowhere")
    (base / "robot" / KEY).chmod(0o640)
    with pytest.raises(KeysError, match="others may read"):
        serve(base / "robot")
    make_authority(base, 0, force=True)
    with pytest.raises(KeysError, match="ended on"):
        serve(base / "robot")
    assert security(load()) is None


@pytest.mark.parametrize(
    "address",
    ["tcp/0.0.0.0:7448", "tcp/127.0.0.1:7448", "192.0.2.1:7448", "tls/192.0.2.1", "quic/[::]:7448", "tls/:1"],
)
def test_nothing_but_tls_is_served(address: str) -> None:
    with pytest.raises(ConfigError, match=r"network\.listen.*tls/ADDRESS:PORT") as told:
        load(network={"listen": [address]})
    assert "\n" not in str(told.value)
    assert (
        load(network={"listen": ["tls/0.0.0.0:7448", "tls/[::1]:7448"]}).network.listen[1] == "tls/[::1]:7448"
    )


def test_the_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert keys_dir() == tmp_path / "rbtrg" / "keys"

    def run(*words: str) -> str:
        done = CliRunner().invoke(app, ["keys", *words], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.output

    run("init", "--operator", "anna", "--observer", "bob")
    run("add", "cleo", "--role", "observer", "--days", "7")
    run("remove", "bob")
    lines = {line.split(":")[1]: line for line in run("list").splitlines() if ":" in line}
    assert set(lines) == {"anna", "bob", "cleo"}
    assert [name for name, line in lines.items() if "NOT ON THE LIST" in line] == ["bob"]
    with pytest.raises(KeysError, match="--force"):
        run("init")


def test_a_folder_of_others_is_neither_used_nor_changed(tmp_path: Path) -> None:
    """`--dir /tmp` once closed that folder to everybody else."""
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    with pytest.raises(KeysError, match="writable by others"):
        make_authority(shared, 30)
    assert shared.stat().st_mode & 0o7777 == 0o1777
    assert not list(shared.iterdir())
    readable = tmp_path / "readable"
    readable.mkdir(mode=0o755)
    make_authority(readable, 30)
    assert readable.stat().st_mode & 0o777 == 0o755
    assert (readable / "ca").stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("name", ["file", "file/below", "/proc/keys", "dangling"])
def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    with pytest.raises(KeysError, match="name another folder"):
        make_authority(tmp_path / name, 30)


def test_a_damaged_list_or_key_makes_no_certificate(base: Path) -> None:
    (base / "robot" / certificates.ACCESS).write_bytes(b"\xff\xfe")
    with pytest.raises(KeysError, match="cannot read"):
        add(base, "zoe", Role.OBSERVER, 30)
    (base / "robot" / certificates.ACCESS).write_bytes(b"")
    (base / "ca" / KEY).write_text("no key")
    with pytest.raises(KeysError, match="is no key"):
        add(base, "zoe", Role.OBSERVER, 30)
    assert not (base / "zoe").exists()


def test_the_authoritys_key_opens_with_its_passphrase_alone(tmp_path: Path) -> None:
    base = tmp_path / "keys"
    make_authority(base, 5, passphrase="a long word")
    with pytest.raises(TypeError, match="encrypted"):
        load_pem_private_key((base / "ca" / KEY).read_bytes(), None)
    for passphrase, words in (
        ("", "set RBTRG_PASSPHRASE"),
        ("another", "does not open with this passphrase"),
    ):
        with pytest.raises(KeysError, match=words):
            add(base, "anna", Role.OPERATOR, 5, passphrase=passphrase)
    assert listed(base / ROBOT) == []
    assert (add(base, "anna", Role.OPERATOR, 5, passphrase="a long word") / KEY).is_file()
    assert load_pem_private_key((base / ROBOT / KEY).read_bytes(), None), "the robot starts without anybody"


def test_an_open_key_beside_the_robots_is_told(base: Path, tmp_path: Path) -> None:
    assert f"{base / 'ca' / KEY} lies open" in lies_open(base / ROBOT)
    make_authority(tmp_path / "sealed", 5, passphrase="a long word")
    assert lies_open(tmp_path / "sealed" / ROBOT) == ""
    (base / "ca" / KEY).unlink()
    assert lies_open(base / ROBOT) == ""


def test_keys_are_made_with_the_passphrase_of_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RBTRG_PASSPHRASE", "a long word")
    base = tmp_path / "keys"
    made = CliRunner().invoke(app, ["keys", "init", "--dir", str(base), "--operator", "anna"])
    assert "its key encrypted" in made.output
    added = CliRunner().invoke(app, ["keys", "add", "bob", "--role", "observer", "--dir", str(base)])
    assert added.exit_code == 0
    monkeypatch.delenv("RBTRG_PASSPHRASE")
    refused = CliRunner().invoke(app, ["keys", "add", "cleo", "--role", "observer", "--dir", str(base)])
    assert isinstance(refused.exception, KeysError)

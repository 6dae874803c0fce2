"""Makes certificates: an authority, the robot's, and one for each person, whose common name says the role.

    DIR/ca/      certificate.pem key.pem                   the authority; whoever has this key lets anybody in
    DIR/robot/   ca.pem certificate.pem key.pem access.txt for the robot's computer
    DIR/NAME/    ca.pem certificate.pem key.pem            for the computer of that person

EC P-256, keys in PKCS#8; the authority's is encrypted where there is a passphrase. A common name is `role:name:number`.
The number is new each time: a certificate that was taken off the list does not count again when its owner gets another
one.
"""

from __future__ import annotations

import os
import re
import secrets
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from hal.errors import OperatorError, one_line
from rbtrg_robot.access.identity import CA, CERTIFICATE, KEY, ROBOT, problem
from rbtrg_robot.topics import Role

AUTHORITY = "ca"
ACCESS = "access.txt"
"""In the robot's folder: the common names that may connect, one on a line."""
PASSPHRASE = "RBTRG_PASSPHRASE"
"""Environment: of the key of the authority, where nobody can be asked."""
ENCRYPTED = b"BEGIN ENCRYPTED PRIVATE KEY"
CLOCK_ALLOWANCE = timedelta(minutes=10)
"""A certificate is valid from this long before now: clocks differ."""
_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
_COMMON_NAME = re.compile(rf"({'|'.join(Role)}):({_NAME.pattern}):[0-9a-f]{{8}}")


class KeysError(OperatorError):
    """Keys are missing, in the way, or not to be trusted; the message tells what to do."""


def make_authority(base: Path, days: int, *, force: bool = False, passphrase: str = "") -> None:
    """A new authority and the robot's certificate in `base`; an empty passphrase leaves its key open. Raises
    KeysError."""
    if (base / AUTHORITY).exists() and not force:
        raise KeysError(f"{base} holds keys already; --force makes new ones, and no old certificate counts")
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"rbtrg-robot {secrets.token_hex(4)}")
    usage = x509.KeyUsage(False, False, False, False, False, True, True, False, False)
    certificate = (
        _builder(name, name, key, days)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    for folder in (base, base / AUTHORITY):
        _private_folder(folder)
    _write(base / AUTHORITY, certificate, key, passphrase)
    _issue(base, ROBOT, ROBOT, ExtendedKeyUsageOID.SERVER_AUTH, days, passphrase)
    _replace(base / ROBOT / ACCESS, b"")


def locked(base: Path) -> bool:
    """The key of the authority in `base` is encrypted."""
    return ENCRYPTED in _key_of(base)


def lies_open(folder: Path) -> str:
    """In words, where the key of the authority lies beside the robot's `folder` and is not encrypted; empty where it
    does not."""
    base = folder.parent
    if not os.access(base / AUTHORITY / KEY, os.R_OK) or locked(base):
        return ""
    return (
        f"{base / AUTHORITY / KEY} lies open beside the robot's key: whoever reads it lets anybody in. "
        "Move it to another computer, or encrypt it (docs/operate/security.md)"
    )


def add(base: Path, name: str, role: Role, days: int, *, force: bool = False, passphrase: str = "") -> Path:
    """A certificate for a person, who is put on the robot's list; returns its folder. Raises KeysError."""
    if not _NAME.fullmatch(name) or name in (AUTHORITY, ROBOT):
        raise KeysError(
            f"{name!r} cannot be a name: letters, digits, - and _, at most 32, not `ca` or `robot`"
        )
    if not (base / AUTHORITY / KEY).is_file():
        raise KeysError(f"there is no authority in {base}; make one with `rbtrg-robot keys init`")
    if (base / name).exists() and not force:
        raise KeysError(
            f"{base / name} exists; --force makes a new certificate, and the old one does not count"
        )
    others = [x for x in listed(base / ROBOT) if _owner(x) != name]
    number = secrets.token_hex(4)
    common = f"{role.value}:{name}:{number}"
    _issue(base, name, common, ExtendedKeyUsageOID.CLIENT_AUTH, days, passphrase)
    _rewrite(base, [*others, common])
    return base / name


def remove(base: Path, name: str) -> None:
    """Take a person off the robot's list. Raises KeysError."""
    names = listed(base / ROBOT)
    if name not in map(_owner, names):
        raise KeysError(f"{name!r} is not on the list {base / ROBOT / ACCESS}")
    _rewrite(base, [x for x in names if _owner(x) != name])


def listed(folder: Path) -> list[str]:
    """Common names on the list in the robot's folder. Raises KeysError."""
    try:
        lines = (folder / ACCESS).read_text().split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise KeysError(f"cannot read {folder / ACCESS}: {one_line(error)}") from error
    names = [line.strip() for line in lines if line.strip() and not line.startswith("#")]
    for name in names:
        if not _COMMON_NAME.fullmatch(name):
            raise KeysError(
                f"{folder / ACCESS}: {name!r} is no role:name:number; `rbtrg-robot keys add` writes them"
            )
    return names


def members(folder: Path) -> dict[Role, list[str]]:
    """Common names of each role on the list in the robot's folder. Raises KeysError."""
    names = listed(folder)
    return {role: [x for x in names if x.startswith(f"{role.value}:")] for role in Role}


def certificate_of(folder: Path) -> x509.Certificate:
    """The certificate in a folder. Raises KeysError."""
    try:
        return x509.load_pem_x509_certificate((folder / CERTIFICATE).read_bytes())
    except (OSError, ValueError) as error:
        raise KeysError(f"there is no certificate in {folder / CERTIFICATE}") from error


def common_name(certificate: x509.Certificate) -> str:
    """Role, name and number; `robot` for the robot."""
    return str(certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)


def check(folder: Path) -> None:
    """Raises KeysError where the robot could not serve with the keys in this folder."""
    wrong = problem(folder)
    if wrong:
        raise KeysError(f"network.listen needs keys, but {wrong}; `rbtrg-robot keys init` makes them")
    until = certificate_of(folder).not_valid_after_utc
    if until < datetime.now(UTC):
        raise KeysError(
            f"the certificate in {folder} ended on {until:%Y-%m-%d}; `rbtrg-robot keys init --force`"
        )
    listed(folder)


def _key_of(base: Path) -> bytes:
    try:
        return (base / AUTHORITY / KEY).read_bytes()
    except OSError as error:
        raise KeysError(f"cannot read {base / AUTHORITY / KEY}: {one_line(error)}") from error


def _issue(
    base: Path, folder: str, common: str, purpose: x509.ObjectIdentifier, days: int, passphrase: str
) -> None:
    authority, sealed = certificate_of(base / AUTHORITY), locked(base)
    if sealed and not passphrase:
        raise KeysError(
            f"{base / AUTHORITY / KEY} is encrypted, and its passphrase is missing: set {PASSPHRASE}"
        )
    try:
        signer = load_pem_private_key(_key_of(base), passphrase.encode() if sealed else None)
    except (ValueError, TypeError) as error:
        wrong = "does not open with this passphrase" if sealed else "is no key: take it from a copy"
        raise KeysError(f"{base / AUTHORITY / KEY} {wrong}") from error
    assert isinstance(signer, ec.EllipticCurvePrivateKey)
    key = ec.generate_private_key(ec.SECP256R1())
    usage = x509.KeyUsage(True, False, False, False, False, False, False, False, False)
    certificate = (
        _builder(_name(common), authority.subject, key, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.ExtendedKeyUsage([purpose]), critical=True)
        .add_extension(
            x509.SubjectAlternativeName([x509.DNSName(folder.replace("_", "-").lower())]), critical=False
        )
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), critical=False
        )
        .sign(signer, hashes.SHA256())
    )
    _private_folder(base / folder)
    _write(base / folder, certificate, key)
    _replace(base / folder / CA, authority.public_bytes(Encoding.PEM))


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_ALLOWANCE)
        .not_valid_after(now + timedelta(days=days))
    )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _owner(common: str) -> str:
    return common.split(":")[1]


def _rewrite(base: Path, names: list[str]) -> None:
    _replace(base / ROBOT / ACCESS, "".join(f"{name}\n" for name in names).encode())


def _private_folder(path: Path) -> None:
    """Create the folder for its owner alone. An existing one stays as it is, if nobody else can put files there.
    Raises KeysError."""
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.stat()
    except OSError as error:
        raise KeysError(
            f"cannot keep keys in {path}: {error.strerror}; name another folder with --dir"
        ) from error
    if found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise KeysError(
            f"{path} belongs to somebody else or is writable by others: name another folder with --dir"
        )


def _write(
    folder: Path, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey, passphrase: str = ""
) -> None:
    seal = BestAvailableEncryption(passphrase.encode()) if passphrase else NoEncryption()
    _replace(folder / KEY, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, seal))
    _replace(folder / CERTIFICATE, certificate.public_bytes(Encoding.PEM))


def _replace(path: Path, content: bytes) -> None:
    """Whole or not at all, and never readable by others."""
    fresh = path.with_suffix(".new")
    try:
        fresh.unlink(missing_ok=True)
        with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(content)
        fresh.replace(path)
    except OSError as error:
        raise KeysError(f"cannot write {path}: {error.strerror}") from error

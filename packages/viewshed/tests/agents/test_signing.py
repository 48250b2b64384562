"""Keys that anybody can sign for are not believed, and private keys that others can read are not used."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed.agents.signing import KeyRing, SigningKey, VerifyingKey, read_signing_key, read_verifying_keys
from viewshed.agents.transport import Tls, ZenohTransport

PRIME = 2**255 - 19

# y of the points whose order divides 8 (Chalkias, Garillot, Nikolaenko: Taming the many EdDSAs, 2020).
ORDER_8 = (
    0x7A03AC9277FDC74EC6CC392CFA53202A0F67100D760B3CBA4FD84D3D706A17C7,
    0x05FC536D880238B13933C6D305ACDFD5F098EFF289F4C345B027B2C28F95E826,
)
SMALL = [0, 1, PRIME - 1, *ORDER_8]


def encoded(y: int, sign: int = 0) -> bytes:
    return (y | sign << 255).to_bytes(32, "little")


@pytest.mark.parametrize("y", SMALL)
@pytest.mark.parametrize("sign", [0, 1])
def test_keys_of_small_order_are_refused(y: int, sign: int) -> None:
    with pytest.raises(ValueError, match=r"of large order, got [0-9a-f]{64} of agent 'car1'; make a new key"):
        VerifyingKey("car1", encoded(y, sign))


@pytest.mark.parametrize("y", [2, PRIME, PRIME + 1, PRIME + 3, 2**255 - 1])
@pytest.mark.parametrize("sign", [0, 1])
def test_keys_that_are_no_point_or_have_a_shorter_encoding_are_refused(y: int, sign: int) -> None:
    with pytest.raises(ValueError, match="must be the encoding of a point"):
        VerifyingKey("car1", encoded(y, sign))


@given(st.binary(min_size=32, max_size=32))
def test_keys_made_by_cryptography_are_believed(private: bytes) -> None:
    key = SigningKey("car1", private)
    assert KeyRing((key.verifying(),)).find(key.verifying().key_id) == key.verifying()


def key_file(folder: Path, mode: int) -> str:
    path = folder / "car1.key"
    path.write_text(bytes(range(32)).hex() + "\n")
    path.chmod(mode)
    return str(path)


READERS: list[Callable[[str], object]] = [
    lambda path: read_signing_key("car1", path),
    lambda path: ZenohTransport("car1", tls=Tls(Path("authority.pem"), Path("car1.pem"), Path(path))),
]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("mode", [0o666, 0o644, 0o640, 0o620, 0o602])
def test_a_private_key_that_others_can_read_or_write_is_refused(
    tmp_path: Path, mode: int, read: Callable[[str], object]
) -> None:
    path = key_file(tmp_path, mode)
    with pytest.raises(
        ValueError, match=rf"must be readable by its owner only, got mode 0{mode:o} of {path}; chmod 600 {path}"
    ):
        read(path)


def test_files_of_keys_are_checked(tmp_path: Path) -> None:
    for mode in (0o600, 0o400):
        assert read_signing_key("car1", key_file(tmp_path, mode)).private == bytes(range(32))
        (tmp_path / "car1.key").unlink()
    path = tmp_path / "car1.pub"
    path.write_text(SigningKey.generate("car1").public.hex())
    assert [key.agent for key in read_verifying_keys(["car1"], [str(path)])] == ["car1"]
    with pytest.raises(ValueError, match="one file for each agent, got 1 for car1, car2"):
        read_verifying_keys(["car1", "car2"], [str(path)])
    for text in ("", "00" * 31, "zz" * 32, "é" * 64):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=r"64 hexadecimal digits, got \d+ characters in .*car1.pub"):
            read_verifying_keys(["car1"], [str(path)])
    path.write_text("00" * 32)
    with pytest.raises(ValueError, match=r"of agent 'car1'"):
        read_verifying_keys(["car1"], [str(path)])

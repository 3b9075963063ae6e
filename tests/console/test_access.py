"""Access to the console: tokens, cookies, hosts and origins."""

import pytest

from trimtab.console.access import MOST_WRONG_TOKENS, OBSERVER, PILOT, Access


@pytest.fixture
def noted():
    return []


@pytest.fixture
def access(noted):
    return Access("127.0.0.1", 8080, False, noted.append)


def token(access, role):
    return access.url(role).partition("token=")[2]


@pytest.mark.parametrize("role", [PILOT, OBSERVER])
def test_token_is_exchanged_for_a_cookie_with_the_role(access, role):
    cookie = access.exchange(token(access, role))
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert token(access, role) not in cookie
    assert access.role({"cookie": cookie.partition(";")[0]}) == role


def test_foreign_cookies_have_no_role(access):
    other = Access("127.0.0.1", 8080, False, lambda _: None)
    cookie = other.exchange(token(other, PILOT)).partition(";")[0]
    for header in (
        {},
        {"cookie": ""},
        {"cookie": "trimtab_8080=guess"},
        {"cookie": cookie},
        {"cookie": "a=b; c;;=\x00"},
    ):
        assert access.role(header) is None


def test_wrong_tokens_are_logged_and_then_locked_out(access, noted):
    right = token(access, PILOT)
    assert access.exchange("") is None
    for _ in range(MOST_WRONG_TOKENS):
        assert access.exchange(right[:-1]) is None
    assert len(noted) == MOST_WRONG_TOKENS
    assert access.exchange(right) is None  # too many wrong ones of late


def test_accepts_only_own_hosts_and_origins(access):
    assert all(access.is_own_host(h) for h in ("127.0.0.1:8080", "localhost:8080", "LOCALHOST:8080", "[::1]:8080"))
    assert not any(
        access.is_own_host(h) for h in ("", "127.0.0.1", "127.0.0.1:8081", "evil.example:8080", "10.0.0.1:8080")
    )
    assert access.is_own_origin("http://127.0.0.1:8080")
    wrong = ("", "null", "http://evil.example", "https://127.0.0.1:8080", "http://127.0.0.1:8080.evil.example")
    assert not any(access.is_own_origin(o) for o in wrong)


def test_tls_sets_secure_cookie_and_https_address():
    access = Access("192.168.4.1", 443, True, lambda _: None)
    assert access.url(PILOT).startswith("https://192.168.4.1:443/?token=")
    assert "Secure" in access.exchange(token(access, PILOT))
    assert access.is_own_origin("https://192.168.4.1:443")
    assert not access.is_own_host("localhost:443")


def test_two_consoles_have_different_tokens():
    pair = [Access("127.0.0.1", port, False, lambda _: None) for port in (1, 2)]
    assert len({token(a, role) for a in pair for role in (PILOT, OBSERVER)}) == 4
    assert len(token(pair[0], PILOT)) == 32

//! Access to the page: checks the `Host` and `Origin` headers of a request and the token of an order.

use serde::Serialize;
use std::hint::black_box;
use std::net::{IpAddr, SocketAddr};

/// Who may see the page and use its buttons.
///
/// A browser on the operator's machine also runs foreign pages. What they could do here is prevented by names: a request is
/// answered only when it was made to this machine by an address or by its own name (a foreign name that was made to point here
/// is neither), and a WebSocket is opened only for a page that came from here.
///
/// ```
/// use flockslam_page::{Settings, SettingsError};
///
/// // By default the page is for this machine only, and there its buttons need no token.
/// let guard = Settings::default().guard("robot")?;
/// assert!(guard.is_own_host(Some("localhost:8470")));
/// assert!(!guard.is_own_host(Some("robot:8470")));
/// assert!(guard.may_order(None));
/// # Ok::<(), SettingsError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Guard {
    is_local: bool,
    host_name: String,
    token: Option<String>,
}

/// Whether the page's buttons work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Controls {
    /// For everybody who sees the page.
    Open,
    /// For who knows the token.
    Token,
    /// For no client.
    Off,
}

impl Guard {
    /// For a page at this address of the machine of this name.
    pub fn new(listen: SocketAddr, host_name: &str, token: Option<String>) -> Self {
        Self { is_local: listen.ip().is_loopback(), host_name: host_name.to_ascii_lowercase(), token }
    }

    /// Whether a request with this `Host` header was made to this machine.
    pub fn is_own_host(&self, host: Option<&str>) -> bool {
        let Some(name) = host.and_then(host_without_port) else { return false };
        let name = name.to_ascii_lowercase();
        if let Ok(address) = name.trim_matches(['[', ']']).parse::<IpAddr>() {
            return !self.is_local || address.is_loopback();
        }
        let own = !self.host_name.is_empty()
            && (name == self.host_name || name.strip_suffix(".local") == Some(&self.host_name));
        name == "localhost" || (own && !self.is_local)
    }

    /// Whether a WebSocket with these headers is asked for by this page, or by what is no browser and says nothing of its origin.
    pub fn is_own_origin(&self, origin: Option<&str>, host: Option<&str>) -> bool {
        let same = |origin: &str| {
            let authority = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
            authority.is_some() && authority == host
        };
        self.is_own_host(host) && origin.is_none_or(same)
    }

    /// Whether buttons work.
    pub fn controls(&self) -> Controls {
        match (&self.token, self.is_local) {
            (Some(_), _) => Controls::Token,
            (None, true) => Controls::Open,
            (None, false) => Controls::Off,
        }
    }

    /// Whether an order that comes with this token is to be followed.
    pub fn may_order(&self, given: Option<&str>) -> bool {
        match &self.token {
            Some(token) => given.is_some_and(|given| is_same_secret(token.as_bytes(), given.as_bytes())),
            None => self.is_local,
        }
    }
}

fn host_without_port(host: &str) -> Option<&str> {
    let end = if host.starts_with('[') { host.find(']')? + 1 } else { host.find(':').unwrap_or(host.len()) };
    let (name, port) = host.split_at(end);
    let port_is_good = port.is_empty() || port.strip_prefix(':').is_some_and(|n| n.parse::<u16>().is_ok());
    (port_is_good && !name.is_empty()).then_some(name)
}

/// Compares without unpublished by its time how much of a guess was right.
fn is_same_secret(secret: &[u8], given: &[u8]) -> bool {
    let mut difference = secret.len() ^ given.len();
    for (place, byte) in given.iter().enumerate() {
        difference |= usize::from(byte ^ secret[place % secret.len()]);
    }
    black_box(difference) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard(listen: &str, token: Option<&str>) -> Guard {
        Guard::new(listen.parse().unwrap(), "Robot", token.map(str::to_owned))
    }

    #[test]
    fn only_requests_to_this_machine_by_address_or_its_own_name_are_answered() {
        let (local, open) = (guard("127.0.0.1:8470", None), guard("0.0.0.0:8470", None));
        for host in ["127.0.0.1:8470", "localhost:9000", "localhost", "[::1]:8470", "LOCALHOST"] {
            assert!(local.is_own_host(Some(host)) && open.is_own_host(Some(host)), "{host}");
        }
        for host in ["192.168.1.7:8470", "robot:8470", "robot.local"] {
            assert!(!local.is_own_host(Some(host)) && open.is_own_host(Some(host)), "{host}");
        }
        let foreign = [
            "evil.example:8470",
            "localhost.evil.example",
            "robot.evil",
            "",
            ":8470",
            "[::1",
            "::1:x",
            "a:b",
        ];
        for host in foreign {
            assert!(!local.is_own_host(Some(host)) && !open.is_own_host(Some(host)), "{host}");
        }
        assert!(!local.is_own_host(None));
        assert!(!Guard::new("0.0.0.0:1".parse().unwrap(), "", None).is_own_host(Some(".local")));
    }

    #[test]
    fn a_foreign_page_opens_no_websocket() {
        let guard = guard("127.0.0.1:8470", None);
        let opens = |origin, host| guard.is_own_origin(origin, Some(host));
        assert!(opens(Some("http://localhost:8470"), "localhost:8470"));
        assert!(opens(None, "localhost:8470"), "a program, not a browser");
        for origin in ["http://evil.example", "http://localhost:80", "null", "http://127.0.0.1:8470"] {
            assert!(!opens(Some(origin), "localhost:8470"), "{origin}");
        }
        assert!(!opens(Some("http://evil.example:8470"), "evil.example:8470"), "a name made to point here");
    }

    #[test]
    fn buttons_need_the_token_or_else_this_machine() {
        let secret = "0123456789abcdef";
        let local = guard("127.0.0.1:1", None);
        assert!(local.may_order(None) && local.controls() == Controls::Open);
        let open = guard("0.0.0.0:1", None);
        assert!(!open.may_order(None) && !open.may_order(Some("")) && open.controls() == Controls::Off);
        for listen in ["127.0.0.1:1", "0.0.0.0:1"] {
            let guard = guard(listen, Some(secret));
            assert_eq!(guard.controls(), Controls::Token);
            assert!(guard.may_order(Some(secret)));
            let wrong = [
                None,
                Some(""),
                Some("0123456789abcdeF"),
                Some("0123456789abcdef0"),
                Some("0123456789abcde"),
            ];
            assert!(wrong.iter().all(|given| !guard.may_order(*given)));
            assert!(!guard.may_order(Some(&format!("{secret}{secret}"))));
        }
    }
}

//! The HTTP and WebSocket server of the page: it checks requests, gives the files of the page, sends frames and takes orders.

use crate::bus_watch::watch_bus;
use crate::connection::BoundedListener;
use crate::guard::Guard;
use crate::outbox::{OrderReply, Outbox};
use crate::set_watch::watch_set;
use crate::shared_view::{Place, SetAccess, Shared, Viewer};
use axum::Router;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Deserialize;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::thread;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio::time::timeout;

/// Browsers at once.
const VIEWERS_MAX: usize = 16;
/// Longest message of a browser, bytes.
const MESSAGE_MAX: usize = 4096;
/// A browser that does not take a frame within this is given up.
const WRITE_TIMEOUT: Duration = Duration::from_secs(20);
/// A wrong token is answered after this: guesses take long.
const WRONG_TOKEN_PAUSE: Duration = Duration::from_millis(500);
/// A port that is taken is tried again after this.
const PORT_RETRY: Duration = Duration::from_secs(2);

/// Everything that the page consists of: path, type, content.
const FILES: [(&str, &str, &str); 9] = [
    ("/", "text/html; charset=utf-8", include_str!("../static/index.html")),
    ("/page.css", "text/css; charset=utf-8", include_str!("../static/page.css")),
    ("/main.js", "text/javascript; charset=utf-8", include_str!("../static/main.js")),
    ("/link.js", "text/javascript; charset=utf-8", include_str!("../static/link.js")),
    ("/map.js", "text/javascript; charset=utf-8", include_str!("../static/map.js")),
    ("/tiles.js", "text/javascript; charset=utf-8", include_str!("../static/tiles.js")),
    ("/camera.js", "text/javascript; charset=utf-8", include_str!("../static/camera.js")),
    ("/panel.js", "text/javascript; charset=utf-8", include_str!("../static/panel.js")),
    ("/icon.svg", "image/svg+xml", include_str!("../static/icon.svg")),
];

/// Sent with everything. Nothing comes from elsewhere, and nobody shows the page within his own.
const HEADERS: [(HeaderName, &str); 6] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-cache"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
];

/// Why the page cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// The address cannot be had.
    #[error("page.listen: cannot serve the page at {0}: {1}")]
    Listen(SocketAddr, io::Error),
    /// The system refuses what a server needs.
    #[error("cannot serve the page: {0}")]
    System(#[from] io::Error),
}

/// Where and for whom a page is served.
pub struct Service {
    /// Address and port.
    pub listen: SocketAddr,
    /// For whom.
    pub guard: Guard,
    /// A port that is taken is waited for.
    pub waits_for_port: bool,
}

/// Serves the page of a set until the set ends; `on_ready` gets the address.
///
/// # Errors
/// When the address is not to be had.
pub fn serve(
    place: Place,
    service: Service,
    access: Box<dyn SetAccess>,
    on_ready: impl FnOnce(SocketAddr),
) -> Result<(), PageError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let listener = listen(&service).await.map_err(|error| PageError::Listen(service.listen, error))?;
        on_ready(listener.local_addr()?);
        let shared = Arc::new(Shared::new(&place, service.guard, access));
        let (for_bus, for_set, of_set) = (Arc::clone(&shared), Arc::clone(&shared), place.clone());
        thread::Builder::new().name("bus".to_owned()).spawn(move || watch_bus(&place, &for_bus))?;
        thread::Builder::new().name("set".to_owned()).spawn(move || watch_set(&of_set, &for_set))?;
        let mut ticks = shared.ticks();
        let ended = ticks.wait_for(|_| shared.has_ended());
        let serving = axum::serve(BoundedListener::new(listener), router(&shared)).into_future();
        tokio::select! {
            _ = ended => Ok(()),
            served = serving => Ok(served?),
        }
    })
}

async fn listen(service: &Service) -> io::Result<TcpListener> {
    let mut text = false;
    loop {
        match TcpListener::bind(service.listen).await {
            Err(error) if service.waits_for_port && error.kind() == io::ErrorKind::AddrInUse => {
                if !std::mem::replace(&mut text, true) {
                    tracing::warn!(address = %service.listen, "the page's port is taken: it is served once that is free");
                }
                tokio::time::sleep(PORT_RETRY).await;
            }
            bound => return bound,
        }
    }
}

fn router(shared: &Arc<Shared>) -> Router {
    Router::new()
        .route("/ws", get(open_socket))
        .fallback(give_file)
        .layer(from_fn_with_state(Arc::clone(shared), check))
        .with_state(Arc::clone(shared))
}

fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// Refuses what was not asked of this machine, and puts our headers on every answer.
async fn check(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let mut response = if shared.guard.is_own_host(text(request.headers(), &header::HOST)) {
        next.run(request).await
    } else {
        (StatusCode::FORBIDDEN, "this page is served under the machine's own address and name only\n")
            .into_response()
    };
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn give_file(request: Request) -> Response {
    let file = FILES.iter().find(|(path, ..)| *path == request.uri().path());
    match (request.method(), file) {
        (&Method::GET | &Method::HEAD, Some((_, kind, content))) => {
            ([(header::CONTENT_TYPE, *kind)], *content).into_response()
        }
        (&Method::GET | &Method::HEAD, None) => (StatusCode::NOT_FOUND, "no such file\n").into_response(),
        _ => StatusCode::METHOD_NOT_ALLOWED.into_response(),
    }
}

async fn open_socket(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !shared.guard.is_own_origin(text(&headers, &header::ORIGIN), text(&headers, &header::HOST)) {
        return (StatusCode::FORBIDDEN, "only this page may open its socket\n").into_response();
    }
    let Some(viewer) = Viewer::enter(&shared, VIEWERS_MAX) else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many browsers look at this page\n").into_response();
    };
    let upgrade = upgrade.max_message_size(MESSAGE_MAX).max_frame_size(MESSAGE_MAX);
    upgrade.on_upgrade(move |socket| attend(socket, viewer))
}

/// What a browser says.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
enum BrowserMessage {
    /// It has drawn a frame.
    Drawn(u64),
    /// It wants something done.
    Order {
        /// A number to know the answer by.
        id: u64,
        /// Its token.
        token: Option<String>,
        /// What.
        what: Wanted,
    },
}

/// What can be ordered.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Wanted {
    /// Other processes for a stage.
    Restart(String),
    /// That the set rests, or goes on.
    Pause(bool),
    /// That the set localizes in its map as it is, or maps again.
    Localize(bool),
    /// The map on disk.
    Save,
}

/// Serves one browser until it goes.
async fn attend(mut socket: WebSocket, viewer: Viewer) {
    let shared = viewer.shared();
    let mut ticks = shared.ticks();
    let (replies, mut replied) = mpsc::channel::<OrderReply>(1);
    let mut outbox = Outbox::default();
    let mut is_due = true;
    while !shared.has_ended() {
        tokio::select! {
            received = socket.recv() => if !handle(received, &mut outbox, shared, &replies) { return },
            Some(reply) = replied.recv() => outbox.reply(&reply),
            _ = ticks.changed() => is_due = true,
        }
        if is_due {
            let now_ms = shared.now_ms();
            let frame = outbox.next_frame(&shared.view(), shared.guard.controls(), now_ms);
            let Some(frame) = frame else { continue };
            is_due = false;
            if !matches!(timeout(WRITE_TIMEOUT, socket.send(Message::Binary(frame.into()))).await, Ok(Ok(())))
            {
                return;
            }
        }
    }
}

/// Takes in what a browser says; false when it has gone or makes no sense.
fn handle(
    message: Option<Result<Message, axum::Error>>,
    outbox: &mut Outbox,
    shared: &Arc<Shared>,
    replies: &mpsc::Sender<OrderReply>,
) -> bool {
    let text = match message {
        Some(Ok(Message::Text(text))) => text,
        Some(Ok(Message::Ping(_) | Message::Pong(_))) => return true,
        _ => return false,
    };
    match serde_json::from_str(&text) {
        Ok(BrowserMessage::Drawn(frame)) => outbox.answered(frame),
        Ok(BrowserMessage::Order { id, token, what }) => match replies.clone().try_reserve_owned() {
            Ok(place) => {
                let shared = Arc::clone(shared);
                tokio::spawn(async move {
                    place.send(obey(&shared, id, token.as_deref(), what).await);
                });
            }
            Err(_) => {
                outbox.reply(&OrderReply { id, ok: false, text: "one thing after the other".to_owned() })
            }
        },
        Err(_) => return false,
    }
    true
}

async fn obey(shared: &Arc<Shared>, id: u64, token: Option<&str>, what: Wanted) -> OrderReply {
    if !shared.guard.may_order(token) {
        tokio::time::sleep(WRONG_TOKEN_PAUSE).await;
        return OrderReply { id, ok: false, text: "this needs the right token".to_owned() };
    }
    let asked = Arc::clone(shared);
    // The supervisor may take its time.
    let done = tokio::task::spawn_blocking(move || match what {
        Wanted::Restart(stage) => asked.access.restart(&stage).map(|()| {
            asked.note_order(Some(&stage), format!("{stage} restarted from the page"));
            format!("{stage} restarted")
        }),
        Wanted::Pause(rests) => asked.access.pause(rests).map(|()| {
            let text = if rests { "the set was paused" } else { "the set goes on" };
            asked.note_order(None, format!("{text}, from the page"));
            text.to_owned()
        }),
        Wanted::Localize(localizes) => asked.access.localize(localizes).map(|()| {
            let text = if localizes { "the set localizes in its map" } else { "the map is made further" };
            asked.note_order(None, format!("{text}, from the page"));
            text.to_owned()
        }),
        Wanted::Save => asked.access.save().map(|place| {
            asked.note_order(None, format!("map saved in {place}"));
            format!("map saved in {place}")
        }),
    });
    match done.await {
        Ok(Ok(text)) => OrderReply { id, ok: true, text },
        Ok(Err(text)) => OrderReply { id, ok: false, text },
        Err(_) => OrderReply { id, ok: false, text: "it could not be done".to_owned() },
    }
}

//! A websocket server on loopback that speaks Foxglove's protocol: it advertises the topics and sends each client what it subscribed to.

use super::{RecordError, RecordTopic, Recorded};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;
use tungstenite::handshake::server::{Request, Response};
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

/// Names of the protocol, the newer first: what is said is the same in both.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
const PROTOCOL_HEADER: &str = "Sec-WebSocket-Protocol";
/// Messages that wait for a client; a slow one misses what comes then.
const QUEUE: usize = 256;
const CLIENTS_MAX: usize = 8;
/// The server reads from a client for so long, then it sends what has arrived.
const LISTEN: Duration = Duration::from_millis(10);
/// A client that takes nothing for so long is left.
const WRITE_LIMIT: Duration = Duration::from_secs(2);
/// Begins a message in binary.
const MESSAGE_DATA: u8 = 1;

/// A websocket server on loopback that Foxglove can be pointed at. Each client has a thread and a bounded queue, so that none
/// of them holds up the recorder or another.
pub struct FoxgloveServer {
    clients: Arc<Mutex<Vec<Client>>>,
    /// The last grid, for late subscribers: it changes seldom while a robot stands.
    grid: Arc<Mutex<Option<Arc<Recorded>>>>,
    missed: Arc<AtomicU64>,
    port: u16,
}

struct Client {
    queue: SyncSender<Arc<Recorded>>,
}

impl FoxgloveServer {
    /// Listens on 127.0.0.1 at `port`; 0 takes a free one.
    ///
    /// # Errors
    /// When the port cannot be opened.
    pub fn start(port: u16, robot: &str) -> Result<Self, RecordError> {
        let failed = |source| RecordError::Port { port, source };
        let listener = TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port))).map_err(failed)?;
        let server = Self {
            clients: Arc::default(),
            grid: Arc::default(),
            missed: Arc::default(),
            port: listener.local_addr().map_err(failed)?.port(),
        };
        let (clients, grid, robot) =
            (Arc::clone(&server.clients), Arc::clone(&server.grid), robot.to_owned());
        let accept = move || {
            for stream in listener.incoming().flatten() {
                let (queue, messages) = sync_channel(QUEUE);
                let mut clients = clients.lock().unwrap_or_else(PoisonError::into_inner);
                if clients.len() >= CLIENTS_MAX {
                    tracing::warn!("a client was turned away: {CLIENTS_MAX} are here already");
                    continue;
                }
                let (robot, grid) = (robot.clone(), Arc::clone(&grid));
                let serves = move || {
                    if let Err(problem) = serve(stream, &robot, &messages, &grid) {
                        tracing::debug!(%problem, "a client of the websocket has gone");
                    }
                };
                // Its end closes the queue, by which it is dropped.
                if thread::Builder::new().name("foxglove-client".to_owned()).spawn(serves).is_ok() {
                    clients.push(Client { queue });
                }
            }
        };
        thread::Builder::new().name("foxglove".to_owned()).spawn(accept).map_err(failed)?;
        Ok(server)
    }

    /// The port that it listens on.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Hands a message to all clients that keep up.
    pub fn put(&self, message: Recorded) {
        let message = Arc::new(message);
        if message.topic == RecordTopic::Grid {
            *self.grid.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&message));
        }
        let mut clients = self.clients.lock().unwrap_or_else(PoisonError::into_inner);
        clients.retain(|client| match client.queue.try_send(Arc::clone(&message)) {
            Ok(()) => true,
            Err(TrySendError::Full(_)) => {
                self.missed.fetch_add(1, Ordering::Relaxed);
                true
            }
            Err(TrySendError::Disconnected(_)) => false,
        });
    }

    /// Messages that clients were too slow for.
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }
}

/// Subscriptions of a client: the topic of each, by its number.
type Subscriptions = BTreeMap<u32, RecordTopic>;

fn serve(
    stream: TcpStream,
    robot: &str,
    messages: &Receiver<Arc<Recorded>>,
    grid: &Mutex<Option<Arc<Recorded>>>,
) -> Result<(), Box<dyn std::error::Error>> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(WRITE_LIMIT))?;
    stream.set_write_timeout(Some(WRITE_LIMIT))?;
    // Whoever speaks no protocol of these would not understand.
    let mut socket = tungstenite::accept_hdr(stream, choose).map_err(|error| error.to_string())?;
    socket.get_ref().set_read_timeout(Some(LISTEN))?;
    socket.send(Message::text(server_info(robot).to_string()))?;
    socket.send(Message::text(advertisement().to_string()))?;
    let mut subscriptions = Subscriptions::new();
    loop {
        let new = listen(&mut socket, &mut subscriptions)?;
        let last = grid.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some(last) = last.filter(|_| new.contains(&RecordTopic::Grid)) {
            send_message(&mut socket, &subscriptions, &last)?;
        }
        loop {
            match messages.try_recv() {
                Ok(message) => send_message(&mut socket, &subscriptions, &message)?,
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return Ok(socket.close(None)?),
            }
        }
    }
}

/// Takes the first of our protocols that the client offers.
// The size of the error is tungstenite's.
#[allow(clippy::result_large_err)]
fn choose(
    request: &Request,
    mut response: Response,
) -> Result<Response, tungstenite::handshake::server::ErrorResponse> {
    let offered = request.headers().get_all(PROTOCOL_HEADER).iter().filter_map(|value| value.to_str().ok());
    let offered: Vec<&str> = offered.flat_map(|value| value.split(',')).map(str::trim).collect();
    match PROTOCOLS.into_iter().find(|protocol| offered.contains(protocol)) {
        Some(protocol) => {
            response.headers_mut().insert(PROTOCOL_HEADER, HeaderValue::from_static(protocol));
            Ok(response)
        }
        None => {
            let mut refusal = tungstenite::handshake::server::ErrorResponse::new(Some(format!(
                "one of {} is expected\n",
                PROTOCOLS.join(", ")
            )));
            *refusal.status_mut() = tungstenite::http::StatusCode::BAD_REQUEST;
            Err(refusal)
        }
    }
}

/// Takes in what the client says until it pauses; the topics that it subscribed to.
fn listen(
    socket: &mut WebSocket<TcpStream>,
    subscriptions: &mut Subscriptions,
) -> Result<Vec<RecordTopic>, tungstenite::Error> {
    match socket.read() {
        Ok(Message::Text(text)) => Ok(obey(&text, subscriptions)),
        Ok(_) => Ok(Vec::new()),
        Err(tungstenite::Error::Io(error))
            if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) =>
        {
            Ok(Vec::new())
        }
        Err(error) => Err(error),
    }
}

/// Changes the subscriptions as a request wants it; what is not known is left alone.
fn obey(request: &str, subscriptions: &mut Subscriptions) -> Vec<RecordTopic> {
    let Ok(request) = serde_json::from_str::<Value>(request) else { return Vec::new() };
    let number = |value: &Value| value.as_u64().and_then(|number| u32::try_from(number).ok());
    let list = |name: &str| request[name].as_array().cloned().unwrap_or_default();
    match request["op"].as_str() {
        Some("subscribe") => {
            let wanted = list("subscriptions").into_iter().filter_map(|one| {
                let place = number(&one["channelId"])? as usize;
                Some((number(&one["id"])?, *RecordTopic::OF_JSON.get(place.checked_sub(1)?)?))
            });
            let wanted: Vec<_> = wanted.collect();
            subscriptions.extend(wanted.iter().copied());
            wanted.into_iter().map(|(_, topic)| topic).collect()
        }
        Some("unsubscribe") => {
            for id in list("subscriptionIds").iter().filter_map(number) {
                subscriptions.remove(&id);
            }
            Vec::new()
        }
        _ => Vec::new(),
    }
}

fn send_message(
    socket: &mut WebSocket<TcpStream>,
    subscriptions: &Subscriptions,
    message: &Recorded,
) -> Result<(), tungstenite::Error> {
    for (id, _) in subscriptions.iter().filter(|(_, topic)| **topic == message.topic) {
        socket.send(Message::binary(message_data(*id, message)))?;
    }
    Ok(())
}

fn message_data(subscription: u32, message: &Recorded) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(13 + message.data.len());
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&message.utc_ns.to_le_bytes());
    bytes.extend_from_slice(&message.data);
    bytes
}

fn server_info(robot: &str) -> Value {
    json!({ "op": "serverInfo", "name": format!("flockslam {robot}"), "capabilities": [], "metadata": {} })
}

/// All topics of JSON; channels are numbered from 1 in their order.
fn advertisement() -> Value {
    let channel = |topic: RecordTopic| {
        json!({
            "id": topic.place() + 1, "topic": topic.name(), "encoding": "json", "schemaName": topic.schema_name(),
            "schema": topic.schema(), "schemaEncoding": "jsonschema",
        })
    };
    json!({ "op": "advertise", "channels": RecordTopic::OF_JSON.map(channel) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tungstenite::client::IntoClientRequest;
    use tungstenite::stream::MaybeTlsStream;

    fn connect(port: u16, protocol: Option<&'static str>) -> Option<WebSocket<MaybeTlsStream<TcpStream>>> {
        let mut request = format!("ws://127.0.0.1:{port}").into_client_request().unwrap();
        if let Some(protocol) = protocol {
            request.headers_mut().insert(PROTOCOL_HEADER, HeaderValue::from_static(protocol));
        }
        let (socket, response) = tungstenite::connect(request).ok()?;
        let chosen = response.headers().get(PROTOCOL_HEADER).unwrap().to_str().unwrap().to_owned();
        assert!(PROTOCOLS.contains(&chosen.as_str()));
        Some(socket)
    }

    fn text(message: Message) -> Value {
        serde_json::from_str(message.to_text().unwrap()).unwrap()
    }

    #[test]
    fn a_client_gets_what_it_subscribes_to_and_others_do_not_hold_it_up() {
        let server = FoxgloveServer::start(0, "r1").unwrap();
        assert!(connect(server.port(), None).is_none());
        assert!(connect(server.port(), Some("chat")).is_none());
        let _silent = TcpStream::connect(("127.0.0.1", server.port())).unwrap();
        let mut client = connect(server.port(), Some("foxglove.websocket.v1")).unwrap();
        assert_eq!(text(client.read().unwrap())["name"], "flockslam r1");
        let channels = text(client.read().unwrap())["channels"].clone();
        assert_eq!(channels.as_array().unwrap().len(), RecordTopic::OF_JSON.len());
        let grid = Recorded { topic: RecordTopic::Grid, utc_ns: 5, data: b"{\"grid\":1}".to_vec() };
        server.put(grid.clone());
        let id = channels.as_array().unwrap().iter().find(|c| c["topic"] == "/grid").unwrap()["id"].clone();
        let wanted = json!({ "op": "subscribe", "subscriptions": [{ "id": 77, "channelId": id }] });
        client.send(Message::text(wanted.to_string())).unwrap();
        // The last one comes at once, though it was sent before.
        assert_eq!(client.read().unwrap().into_data().to_vec(), message_data(77, &grid));
        server.put(Recorded { topic: RecordTopic::Log, utc_ns: 6, data: b"{}".to_vec() });
        let next = Recorded { topic: RecordTopic::Grid, utc_ns: 7, data: b"{\"grid\":2}".to_vec() };
        server.put(next.clone());
        // The first may come twice: from the queue as well.
        let newer = std::iter::repeat_with(|| client.read().unwrap().into_data().to_vec())
            .find(|bytes| *bytes != message_data(77, &grid));
        assert_eq!(newer, Some(message_data(77, &next)));
    }

    #[test]
    fn requests_change_subscriptions_and_nonsense_does_not() {
        let mut subscriptions = Subscriptions::new();
        let new = obey(
            r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":1},{"id":2,"channelId":99},{"id":-1,"channelId":2},{"id":3,"channelId":0}]}"#,
            &mut subscriptions,
        );
        assert_eq!((new, subscriptions.clone()), (vec![RecordTopic::Scan], [(1, RecordTopic::Scan)].into()));
        for nonsense in ["", "{}", "[1]", r#"{"op":"subscribe"}"#, r#"{"op":"fly"}"#] {
            assert!(obey(nonsense, &mut subscriptions).is_empty());
        }
        obey(r#"{"op":"unsubscribe","subscriptionIds":[1, 5]}"#, &mut subscriptions);
        assert!(subscriptions.is_empty());
    }
}

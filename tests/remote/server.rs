//! A local object server with the subset of S3 that the reader uses, and configurable failures.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

/// The only bucket.
pub const BUCKET: &str = "logs";

/// The only known key.
pub const KEY_ID: &str = "AKIDTEST";

/// Failures of the server.
#[derive(Clone, Copy, Debug, Default)]
pub struct Behaviour {
    /// Interval of answers whose body is truncated; 0: never.
    pub truncate_every: usize,
    /// Number of truncated answers after which none is truncated.
    pub intact_after: Option<usize>,
    /// Number of requests answered with 503 before the others.
    pub busy_requests: usize,
    /// Ignores range requests, and sends whole objects.
    pub ignores_ranges: bool,
    /// Requests need no signature.
    pub is_public: bool,
    /// Requests need this user and password, as in the header.
    pub login: Option<&'static str>,
    /// Interval between the bytes of an answer, ms; 0: all at once.
    pub byte_interval_ms: u64,
    /// No request is answered.
    pub is_silent: bool,
    /// Number of requests after which the objects change; 0: never.
    pub changes_after: usize,
}

/// Statistics of the requests.
#[derive(Debug, Default)]
pub struct Counts {
    pub requests: AtomicUsize,
    /// Number of answers with a body.
    bodies: AtomicUsize,
    /// Number of bytes of objects that were sent.
    pub bytes: AtomicUsize,
}

pub struct Server {
    address: SocketAddr,
    counts: Arc<Counts>,
    is_stopping: Arc<AtomicBool>,
}

struct Shared {
    objects: BTreeMap<String, Vec<u8>>,
    behaviour: Behaviour,
    counts: Arc<Counts>,
    /// One answer at a time, so that truncation is deterministic.
    turn: Mutex<()>,
}

impl Server {
    /// Serves `objects`, by their keys.
    pub fn start(objects: &[(&str, &[u8])], behaviour: Behaviour) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let address = listener.local_addr().expect("its address");
        let own = |&(key, bytes): &(&str, &[u8])| (key.to_owned(), bytes.to_owned());
        let counts = Arc::new(Counts::default());
        let shared = Arc::new(Shared {
            objects: objects.iter().map(own).collect(),
            behaviour,
            counts: Arc::clone(&counts),
            turn: Mutex::default(),
        });
        let is_stopping = Arc::new(AtomicBool::new(false));
        let should_stop = Arc::clone(&is_stopping);
        thread::spawn(move || {
            for connection in listener.incoming().flatten() {
                if should_stop.load(Ordering::Relaxed) {
                    return;
                }
                let shared = Arc::clone(&shared);
                // A client may disconnect.
                thread::spawn(move || shared.answer(connection));
            }
        });
        Self { address, counts, is_stopping }
    }

    pub fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    pub fn counts(&self) -> &Counts {
        &self.counts
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.is_stopping.store(true, Ordering::Relaxed);
        drop(TcpStream::connect(self.address));
    }
}

/// The relevant parts of a request.
struct Request {
    method: String,
    target: String,
    range: Option<Range<usize>>,
    authorization: String,
}

impl Request {
    fn read(connection: &TcpStream) -> Option<Self> {
        let mut lines = BufReader::new(connection).lines().map_while(Result::ok);
        let first = lines.next()?;
        let mut words = first.split(' ');
        let (method, target) = (words.next()?.to_owned(), words.next()?.to_owned());
        let mut request = Self { method, target, range: None, authorization: String::new() };
        for line in lines.take_while(|line| !line.is_empty()) {
            let (name, value) = line.split_once(": ")?;
            match name.to_ascii_lowercase().as_str() {
                "authorization" => request.authorization = value.to_owned(),
                "range" => {
                    let (first, last) = value.strip_prefix("bytes=")?.split_once('-')?;
                    request.range = Some(first.parse().ok()?..last.parse::<usize>().ok()? + 1);
                }
                _ => {}
            }
        }
        Some(request)
    }
}

impl Shared {
    fn answer(&self, mut connection: TcpStream) -> Option<()> {
        let request = Request::read(&connection)?;
        let _turn = self.turn.lock().ok()?;
        if self.behaviour.is_silent {
            thread::sleep(Duration::from_secs(600));
            return None;
        }
        let number = 1 + self.counts.requests.fetch_add(1, Ordering::Relaxed);
        let mut refuse = |status: &str, code: &str| {
            let body =
                format!("<Error><Code>{code}</Code><Message>It is {code}.</Message></Error>");
            let length = body.len();
            let head = format!(
                "HTTP/1.1 {status}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
            );
            connection.write_all((head + &body).as_bytes()).ok()
        };
        if number <= self.behaviour.busy_requests {
            return refuse("503 Slow Down", "SlowDown");
        }
        let target = request.target.replace("%20", " ");
        let (path, query) = target.split_once('?').unwrap_or((&target, ""));
        let (bucket, key) =
            path.trim_start_matches('/').split_once('/').unwrap_or((&path[1..], ""));
        if !self.behaviour.is_public
            && !request.authorization.contains(&format!("Credential={KEY_ID}/"))
        {
            return refuse("403 Forbidden", "InvalidAccessKeyId");
        }
        if self.behaviour.login.is_some_and(|login| request.authorization != login) {
            return refuse("401 Unauthorized", "NoLogin");
        }
        if bucket != BUCKET {
            return refuse("404 Not Found", "NoSuchBucket");
        }
        if query.contains("list-type=2") {
            return self.list(query, connection);
        }
        let Some(object) = self.objects.get(key) else {
            return refuse("404 Not Found", "NoSuchKey");
        };
        let asked = request.range.clone().filter(|_| !self.behaviour.ignores_ranges);
        if asked.as_ref().is_some_and(|range| range.start >= object.len()) {
            return refuse("416 Range Not Satisfiable", "InvalidRange");
        }
        let range =
            asked.clone().map_or(0..object.len(), |range| range.start..range.end.min(object.len()));
        let changed = self.behaviour.changes_after > 0 && number >= self.behaviour.changes_after;
        let (status, tag) =
            (if asked.is_some() { "206 Partial Content" } else { "200 OK" }, u8::from(changed));
        let mut head = format!(
            "HTTP/1.1 {status}\r\nContent-Length: {}\r\nETag: \"{tag}\"\r\n\
             Last-Modified: Sun, 01 Nov 2026 00:00:00 GMT\r\nConnection: close\r\n",
            range.len()
        );
        if asked.is_some() {
            let (first, last, size) = (range.start, range.end - 1, object.len());
            head += &format!("Content-Range: bytes {first}-{last}/{size}\r\n");
        }
        connection.write_all((head + "\r\n").as_bytes()).ok()?;
        if request.method == "HEAD" {
            return Some(());
        }
        let body = 1 + self.counts.bodies.fetch_add(1, Ordering::Relaxed);
        let mut part = &object[range];
        let is_over = self.behaviour.intact_after.is_some_and(|last| body > last);
        if self.behaviour.truncate_every > 0
            && body.is_multiple_of(self.behaviour.truncate_every)
            && !is_over
        {
            part = &part[..part.len() / 2];
        }
        self.counts.bytes.fetch_add(part.len(), Ordering::Relaxed);
        if self.behaviour.byte_interval_ms > 0 {
            for byte in part.chunks(1) {
                connection.write_all(byte).ok()?;
                thread::sleep(Duration::from_millis(self.behaviour.byte_interval_ms));
            }
        }
        connection.write_all(part).ok()?;
        connection.shutdown(Shutdown::Write).ok()
    }

    /// Lists the objects whose keys start with the query's prefix.
    fn list(&self, query: &str, mut connection: TcpStream) -> Option<()> {
        let prefix = query.split('&').find_map(|pair| pair.strip_prefix("prefix="));
        let prefix = prefix.unwrap_or_default().replace("%2F", "/");
        let mut body = "<ListBucketResult><IsTruncated>false</IsTruncated>".to_owned();
        for (key, object) in self.objects.iter().filter(|(key, _)| key.starts_with(&prefix)) {
            body += &format!(
                "<Contents><Key>{key}</Key><Size>{}</Size><ETag>\"0\"</ETag>\
                 <LastModified>2026-11-01T00:00:00.000Z</LastModified></Contents>",
                object.len()
            );
        }
        body += "</ListBucketResult>";
        let length = body.len();
        let head =
            format!("HTTP/1.1 200 OK\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n");
        connection.write_all((head + &body).as_bytes()).ok()
    }
}

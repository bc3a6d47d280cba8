//! SQLite databases of rosbag2, schema versions 1 to 4.
//!
//! All have the tables `topics` and `messages`; version 4 adds `message_definitions`, the schemas.
//! Databases are opened read-only, and no file is created next to them.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use percent_encoding::percent_encode;
use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, OpenFlags, Row};

use super::batch::{Batches, decoded};
use super::beside;
use super::wal;
use crate::decode::{Format, excerpt};
use crate::intake::{ChannelId, Intake};
use crate::losses::Losses;
use crate::{ESCAPED, Extent, ReadOptions};

/// Damaged places that are skipped.
const MAX_BREAKS: usize = 1000;

/// Topics and definitions.
const MAX_TOPICS: usize = 1 << 20;

/// SQLite allocates a whole row before its content is known.
const MAX_ROW_BYTES: i32 = 256 << 20;

/// Reads the database at `path`. Returns false if it is valid but does not have rosbag2's tables. Calls
/// `opened` when the file name is no longer needed.
pub(crate) fn read(
    path: &Path,
    options: &ReadOptions,
    losses: &mut Losses,
    intake: &mut Intake,
    opened: impl FnOnce(),
) -> bool {
    let tables = |strictness| {
        let database = open(path, strictness)?;
        let tables = Tables::inspect(&database)?;
        Ok((database, tables))
    };
    let mut is_cut = false;
    let tables: rusqlite::Result<_> = tables(Strictness::Sound).or_else(|error| {
        let Ok(opened) = tables(Strictness::Damaged) else { return Err(error) };
        let cut = cut(path);
        is_cut = cut.is_some();
        match cut {
            Some((bytes, what)) => losses.add(bytes, Extent::Messages, None, what),
            None => lose(losses, None, "the database is damaged", &error),
        }
        Ok(opened)
    });
    let (database, tables) = match tables {
        Ok(opened) => opened,
        Err(error) => {
            lose(losses, None, "the database cannot be opened", &error);
            return true;
        }
    };
    opened();
    write_ahead_log(path, losses);
    if !tables.topics || !tables.messages {
        return false;
    }
    let journal = beside(path, "-journal");
    if fs::metadata(&journal).is_ok_and(|journal| journal.len() > 0) {
        let what = format!(
            "{} remains from a crash: the last writes may be incomplete",
            journal.display()
        );
        losses.add_unplaced(Extent::Tail, None, what);
    }
    let mut reader = Reader {
        database: &database,
        options,
        losses,
        topics: HashMap::new(),
        bytes: 0,
        orphans: 0,
        before_1970: 0,
        strays: 0,
        strays_here: 0,
        first_stray: (0, 0),
        is_cut,
    };
    reader.topics(tables.definitions, intake);
    reader.messages(intake);
    true
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Strictness {
    Sound,
    /// Its end may be missing, and table descriptions may be damaged.
    Damaged,
}

/// End of a truncated file with a description; `None` if it is as long as its header states.
fn cut(path: &Path) -> Option<(usize, String)> {
    let mut head = [0; 32];
    File::open(path).ok()?.read_exact(&mut head).ok()?;
    let page = match u64::from(u16::from_be_bytes([head[16], head[17]])) {
        1 => 1 << 16,
        page => page,
    };
    let stated = page * u64::from(u32::from_be_bytes([head[28], head[29], head[30], head[31]]));
    let bytes = fs::metadata(path).ok()?.len();
    let what = format!("the database is truncated: {bytes} of {stated} bytes");
    (bytes < stated).then_some((usize::try_from(bytes).ok()?, what))
}

/// Records damage to the write-ahead log, which SQLite does not report.
fn write_ahead_log(path: &Path, losses: &mut Losses) {
    let wal = beside(&fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()), "-wal");
    if !fs::metadata(&wal).is_ok_and(|wal| wal.len() > 0) {
        return;
    }
    let what = match wal::damage(&wal) {
        Ok(None) => return,
        Ok(Some((at, what))) => format!("{}: at byte {at}: {what}", wal.display()),
        Err(error) => format!("{}: {error}", wal.display()),
    };
    losses.add_unplaced(Extent::Messages, None, what);
}

/// Opens a database read-only, without locking it or creating files.
fn open(path: &Path, strictness: Strictness) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
        | OpenFlags::SQLITE_OPEN_URI
        | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let has_wal = fs::metadata(beside(&path, "-wal")).is_ok_and(|wal| wal.len() > 0);
    // An immutable database is read without its write-ahead log. With the log, exclusive use without locks
    // keeps its index in memory.
    let mode = if has_wal && cfg!(unix) { "vfs=unix-none" } else { "immutable=1" };
    let database = Connection::open_with_flags(uri(&path, mode), flags)?;
    database.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_ROW_BYTES)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
    // SQLite reads a damaged database only if its schema is writable; the file is still read-only.
    let is_sound = strictness == Strictness::Sound;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, is_sound)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_WRITABLE_SCHEMA, !is_sound)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    if has_wal {
        database.query_row("PRAGMA locking_mode = EXCLUSIVE", [], |_| Ok(()))?;
    }
    // SQLite does not copy mapped pages.
    database.pragma_update(None, "mmap_size", i64::from(i32::MAX))?;
    Ok(database)
}

fn uri(path: &Path, parameter: &str) -> String {
    let path = percent_encode(path.as_os_str().as_encoded_bytes(), ESCAPED);
    format!("file:{path}?mode=ro&{parameter}")
}

fn lose(losses: &mut Losses, messages: Option<u64>, what: &str, error: &rusqlite::Error) {
    let cause = excerpt(&error.to_string());
    losses.add_unplaced(Extent::Messages, messages, format!("{what}: {cause}"));
}

#[derive(Clone, Copy, Default)]
struct Tables {
    topics: bool,
    messages: bool,
    definitions: bool,
}

impl Tables {
    /// Excludes views, virtual tables and computed columns: reading them would execute untrusted SQL.
    fn inspect(database: &Connection) -> rusqlite::Result<Self> {
        let has = |name: &str| -> rusqlite::Result<bool> {
            database.query_row(
                "SELECT count(*) FROM pragma_table_list WHERE schema = 'main' AND name = ?1 \
                 AND type = 'table' \
                 AND NOT EXISTS (SELECT 1 FROM pragma_table_xinfo(?1) WHERE hidden != 0 \
                 OR name = 'rowid' COLLATE NOCASE)",
                [name],
                |row| Ok(row.get::<_, i64>(0)? > 0),
            )
        };
        Ok(Self {
            topics: has("topics")?,
            messages: has("messages")?,
            definitions: has("message_definitions")?,
        })
    }
}

struct Reader<'a> {
    database: &'a Connection,
    options: &'a ReadOptions,
    losses: &'a mut Losses,
    /// Keyed by topic number; `None` if there are too many channels.
    topics: HashMap<i64, Option<ChannelId>>,
    bytes: usize,
    orphans: u64,
    before_1970: u64,
    strays: usize,
    /// Rows out of order since the last row in order.
    strays_here: u64,
    /// The first row out of order, and the row before it.
    first_stray: (i64, i64),
    /// Lost rows at the end are already reported.
    is_cut: bool,
}

struct Definition {
    encoding: String,
    text: Vec<u8>,
}

impl Reader<'_> {
    fn topics(&mut self, has_definitions: bool, intake: &mut Intake) {
        let mut definitions = HashMap::new();
        let mut listed = Vec::new();
        if has_definitions {
            let query = "SELECT topic_type, encoding, encoded_message_definition \
                         FROM message_definitions";
            self.rows(query, |row| {
                let definition = Definition { encoding: text(row, 1)?, text: text(row, 2)?.into() };
                definitions.insert(text(row, 0)?, definition);
                Ok(())
            });
        }
        self.rows("SELECT id, name, type, serialization_format FROM topics", |row| {
            listed.push((row.get::<_, i64>(0)?, text(row, 1)?, text(row, 2)?, text(row, 3)?));
            Ok(())
        });
        for (id, name, type_name, encoding) in &listed {
            let definition = definitions.get(type_name);
            // Empty if the recorder did not find it.
            let definition = definition.filter(|definition| !definition.text.is_empty());
            let format = Format {
                encoding,
                type_name,
                schema_encoding: definition.map_or("", |definition| &definition.encoding),
                schema: definition.map_or(&[], |definition| &definition.text),
            };
            self.topics.insert(*id, intake.channel(name, format));
        }
    }

    fn rows(&mut self, query: &str, mut take: impl FnMut(&Row<'_>) -> rusqlite::Result<()>) {
        let read = self.database.prepare(query).and_then(|mut statement| {
            let mut rows = statement.query([])?;
            for _ in 0..MAX_TOPICS {
                let Some(row) = rows.next()? else {
                    break;
                };
                take(row)?;
            }
            Ok(())
        });
        if let Err(error) = read {
            lose(self.losses, None, "not all topics can be read", &error);
        }
    }

    /// In the order of recording, skipping damage.
    fn messages(&mut self, intake: &mut Intake) {
        let mut from = self.first_row();
        let mut breaks = 0;
        let content = self.content(intake);
        while let Err(error) =
            decoded(intake, |batches| self.messages_from(&mut from, &content, batches))
        {
            breaks += 1;
            if breaks > MAX_BREAKS {
                let what =
                    format!("rows from {from} on were not read, because too many are damaged");
                lose(self.losses, None, &what, &error);
                break;
            }
            if self.strays > MAX_BREAKS {
                let what = format!("rows from {from} on were not read");
                lose(self.losses, None, &what, &error);
                break;
            }
            let Some(next) = self.next_sound(from).filter(|next| *next > from) else {
                if self.is_cut {
                    break;
                }
                let what = format!("the table `messages` is unreadable from row {from} on");
                lose(self.losses, None, &what, &error);
                break;
            };
            let lost = u64::try_from(next.saturating_sub(from)).ok();
            // Rows out of order are already counted.
            let lost = lost.map(|lost| lost.saturating_sub(self.strays_here));
            let last = next.saturating_sub(1);
            let what = format!("rows {from} to {last} of the table `messages` are unreadable");
            lose(self.losses, lost, &what, &error);
            from = next;
        }
        if self.strays > 0 {
            let (count, (first, before)) = (self.strays, self.first_stray);
            let what = format!(
                "{count} rows of the table `messages` are out of order; the first is row {first} after row \
                 {before}"
            );
            self.losses.add_unplaced(Extent::Messages, Some(count as u64), what);
        }
        if self.before_1970 > 0 {
            let what = format!(
                "the receive time of {} messages is before 1970 and was set to 1970",
                self.before_1970
            );
            intake.note(self.losses.file(), what);
        }
        if self.orphans > 0 {
            let (extent, why) = intake.missing_channel_reason();
            let what = format!("{} messages belong to topics {why}", self.orphans);
            self.losses.add_unplaced(extent, Some(self.orphans), what);
        }
    }

    /// Recorders start at 1, other programs may not.
    fn first_row(&self) -> i64 {
        let first = self
            .database
            .query_row("SELECT min(rowid) FROM messages", [], |row| row.get::<_, Option<i64>>(0));
        first.ok().flatten().map_or(1, |first| first.min(1))
    }

    fn messages_from(
        &mut self,
        from: &mut i64,
        content: &str,
        batches: &mut Batches<'_>,
    ) -> rusqlite::Result<()> {
        let mut statement = self.database.prepare(&format!(
            "SELECT rowid, topic_id, timestamp, {content} FROM messages \
             WHERE rowid >= ?1 ORDER BY rowid"
        ))?;
        let mut rows = statement.query([*from])?;
        while let Some(row) = rows.next()? {
            let id: i64 = row.get(0)?;
            // A page referenced twice, or an overwritten number. Such rows could repeat forever.
            if id < *from {
                self.stray(id, *from)?;
                continue;
            }
            self.message(id, row, batches);
            (*from, self.strays_here) = (id.saturating_add(1), 0);
        }
        Ok(())
    }

    /// Counts row `id`, which is out of order: the next row number is at least `from`.
    ///
    /// # Errors
    /// If there are too many such rows.
    fn stray(&mut self, id: i64, from: i64) -> rusqlite::Result<()> {
        if self.strays == 0 {
            self.first_stray = (id, from.saturating_sub(1));
        }
        (self.strays, self.strays_here) = (self.strays + 1, self.strays_here + 1);
        if self.strays <= MAX_BREAKS {
            return Ok(());
        }
        let code = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_CORRUPT);
        let what = "too many are out of order".to_owned();
        Err(rusqlite::Error::SqliteFailure(code, Some(what)))
    }

    /// SQL expression for message content: empty for unused topics, so the pages of large messages are not
    /// read.
    fn content(&self, intake: &Intake) -> String {
        const MANY: usize = 1000;
        let is_used =
            |channel: &Option<ChannelId>| channel.is_some_and(|channel| !intake.ignores(channel));
        let used = self.topics.iter().filter(|(_, channel)| is_used(channel));
        let mut used: Vec<String> = used.map(|(topic, _)| topic.to_string()).collect();
        if used.len() > MANY || !used.is_empty() && used.len() == self.topics.len() {
            return "data".to_owned();
        }
        used.sort_unstable();
        let no_use = "typeof(topic_id) = 'integer' AND topic_id NOT IN";
        format!("CASE WHEN {no_use} ({}) THEN x'' ELSE data END", used.join(", "))
    }

    fn message(&mut self, id: i64, row: &Row<'_>, batches: &mut Batches<'_>) {
        let content = (row.get_ref(1), row.get_ref(2), row.get_ref(3));
        let (Ok(ValueRef::Integer(topic)), Ok(ValueRef::Integer(time)), Ok(ValueRef::Blob(data))) =
            content
        else {
            let what = format!("row {id} of the table `messages` is not a message");
            return self.losses.add_unplaced(Extent::Messages, Some(1), what);
        };
        self.bytes = self.bytes.saturating_add(data.len());
        self.options.set_position(self.bytes);
        let Some(Some(channel)) = self.topics.get(&topic) else {
            self.orphans += 1;
            return;
        };
        // The database stores the receive time only.
        self.before_1970 += u64::from(time < 0);
        let time = u64::try_from(time).unwrap_or(0);
        batches.add(*channel, id, time, data);
    }

    /// Next readable row after `lost`, by exponential and binary search.
    fn next_sound(&self, mut lost: i64) -> Option<i64> {
        let mut step: i64 = 1;
        let mut sound = loop {
            let from = lost.checked_add(step)?;
            match self.row_from(from) {
                Ok(_) => break from,
                Err(_) => (lost, step) = (from, step.checked_mul(2)?),
            }
        };
        while sound - lost > 1 {
            let middle = lost + (sound - lost) / 2;
            match self.row_from(middle) {
                Ok(_) => sound = middle,
                Err(_) => lost = middle,
            }
        }
        self.row_from(sound).ok().flatten()
    }

    /// First row from `id` on, if readable.
    fn row_from(&self, id: i64) -> rusqlite::Result<Option<i64>> {
        let mut statement = self
            .database
            .prepare("SELECT rowid, data FROM messages WHERE rowid >= ?1 ORDER BY rowid LIMIT 1")?;
        let mut rows = statement.query([id])?;
        match rows.next()? {
            Some(row) => {
                row.get_ref(1)?;
                Ok(Some(row.get(0)?))
            }
            None => Ok(None),
        }
    }
}

fn text(row: &Row<'_>, column: usize) -> rusqlite::Result<String> {
    Ok(match row.get_ref(column)? {
        ValueRef::Text(text) | ValueRef::Blob(text) => String::from_utf8_lossy(text).into_owned(),
        _ => String::new(),
    })
}

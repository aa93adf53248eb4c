//! Opens a run: what it holds, who was there, what is missing; and goes through its frames.
//!
//! A run is read in two passes. The first gathers channels, identities, the hand and all damage, so that a file
//! whose beginning is damaged is still understood by what stands at its end; the second hands out the messages in
//! the order they were written. Memory does not depend on the length of the run.

use super::records::{Damage, Message, Record, Records};
use super::schema::{LinkState, Log, WireFrame};
use super::{FORMAT_VERSION, RunError};
use crate::hand::{Hand, HandError};
use prost::Message as _;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

/// What a channel of a run carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Topic {
    Wire(usize),
    Link(usize),
    Events,
    Other,
}

/// One thing of a run, in the order it was written.
#[derive(Clone, Debug, PartialEq)]
pub enum RunItem {
    /// A frame of a finger.
    Frame {
        /// The finger's place in [`Run::fingers`].
        finger: usize,
        /// Host's clock when it had been read, nanoseconds since the Unix epoch.
        received_ns: u64,
        /// Host's clock when its sample was taken, nanoseconds since the Unix epoch.
        sampled_ns: u64,
        /// The bytes as they came, without delimiter.
        wire: Vec<u8>,
    },
    /// The state of a finger's link.
    Link {
        /// The finger's place in [`Run::fingers`].
        finger: usize,
        /// The state.
        state: LinkState,
    },
    /// Something that happened.
    Event(Log),
}

/// A run that has been looked through once.
#[derive(Clone, Debug)]
pub struct Run {
    path: PathBuf,
    /// What was known when it started.
    pub about: BTreeMap<String, String>,
    /// The fingers' names.
    pub fingers: Vec<String>,
    /// What the boards said of themselves, once per connection.
    pub identities: Vec<BTreeMap<String, String>>,
    /// Names and texts of the hand's files.
    pub hand: Vec<(String, String)>,
    /// Whether the file is complete to its last byte.
    pub complete: bool,
    /// What is damaged or missing.
    pub damage: Vec<Damage>,
    /// First and last time of any message, nanoseconds since the Unix epoch.
    pub span_ns: Option<(u64, u64)>,
    channels: BTreeMap<u16, Topic>,
}

impl Run {
    /// Looks through a run.
    ///
    /// # Errors
    /// [`RunError::Read`], [`RunError::NotARun`], [`RunError::TooNew`]; damage is no error.
    pub fn open(path: &Path) -> Result<Self, RunError> {
        let mut run = Self {
            path: path.into(),
            about: BTreeMap::new(),
            fingers: Vec::new(),
            identities: Vec::new(),
            hand: Vec::new(),
            complete: false,
            damage: Vec::new(),
            span_ns: None,
            channels: BTreeMap::new(),
        };
        let mut topics = BTreeMap::new();
        let mut profile = None;
        run.each_record(|run, record| {
            match record {
                Record::Header { profile: found, .. } => profile = Some(found),
                Record::Channel { id, topic } => drop(topics.insert(id, topic)),
                Record::Metadata { name, entries } if name == "palpus.run" => run.about = entries,
                Record::Metadata { name, entries } if name.starts_with(super::IDENTITY) => {
                    run.identities.push(entries);
                }
                Record::Attachment { name, data } => {
                    if let Some(file) = name.strip_prefix("hand/") {
                        let text = String::from_utf8_lossy(&data).into_owned();
                        run.hand.push((file.to_owned(), text));
                    }
                }
                Record::Message(message) if !message.doubtful => {
                    let (first, last) = run.span_ns.unwrap_or((u64::MAX, 0));
                    let time = message.log_time_ns;
                    run.span_ns = Some((first.min(time), last.max(time)));
                }
                Record::Damage(damage) => run.damage.push(damage),
                Record::End => run.complete = true,
                Record::Metadata { .. } | Record::Message(_) => {}
            }
            Ok(())
        })?;
        if profile.as_deref().is_some_and(|p| p != "palpus") {
            let profile = profile.unwrap_or_default();
            return Err(run.not_a_run(format!("it is an MCAP file of profile `{profile}`")));
        }
        let version = run.about.get("format_version").and_then(|v| v.parse().ok());
        if let Some(found) = version.filter(|found| *found > FORMAT_VERSION) {
            return Err(RunError::TooNew {
                path: path.into(),
                found,
            });
        }
        run.name_channels(&topics);
        Ok(run)
    }

    fn name_channels(&mut self, topics: &BTreeMap<u16, String>) {
        if let Some(names) = self.about.get("fingers") {
            self.fingers = names.split('\n').map(str::to_owned).collect();
        }
        for (&id, topic) in topics {
            let mut finger = |name: &str| {
                let known = self.fingers.iter().position(|f| f == name);
                known.unwrap_or_else(|| {
                    self.fingers.push(name.to_owned());
                    self.fingers.len() - 1
                })
            };
            let parts: Vec<&str> = topic.split('/').collect();
            let topic = match parts[..] {
                ["", name, "wire"] => Topic::Wire(finger(name)),
                ["", name, "link"] => Topic::Link(finger(name)),
                ["", "events"] => Topic::Events,
                _ => Topic::Other,
            };
            self.channels.insert(id, topic);
        }
    }

    /// The hand the run was captured with; `None` if the run holds none.
    ///
    /// # Errors
    /// [`HandError`] if what it holds can't be used.
    pub fn read_hand(&self) -> Result<Option<Hand>, HandError> {
        if self.hand.is_empty() {
            return Ok(None);
        }
        Hand::from_sources(&self.hand).map(Some)
    }

    /// Goes through the run's messages in the order they were written.
    ///
    /// Messages from damaged chunks are left out, but for frames, which carry a check sum of their own: those
    /// are handed out for the caller to check.
    ///
    /// # Errors
    /// [`RunError::Read`].
    pub fn each(&self, mut take: impl FnMut(RunItem)) -> Result<(), RunError> {
        let mut run = self.clone();
        run.each_record(|run, record| {
            if let Record::Message(message) = record
                && let Some(item) = run.item(message)
            {
                take(item);
            }
            Ok(())
        })
    }

    fn item(&self, message: Message) -> Option<RunItem> {
        match *self.channels.get(&message.channel)? {
            Topic::Wire(finger) => Some(RunItem::Frame {
                finger,
                received_ns: message.log_time_ns,
                sampled_ns: message.publish_time_ns,
                wire: WireFrame::decode(&message.data[..]).ok()?.frame,
            }),
            Topic::Link(finger) if !message.doubtful => Some(RunItem::Link {
                finger,
                state: LinkState::decode(&message.data[..]).ok()?,
            }),
            Topic::Events if !message.doubtful => {
                Some(RunItem::Event(Log::decode(&message.data[..]).ok()?))
            }
            _ => None,
        }
    }

    fn each_record(
        &mut self,
        mut take: impl FnMut(&mut Self, Record) -> Result<(), RunError>,
    ) -> Result<(), RunError> {
        let path = self.path.clone();
        let read_error = |source: io::Error| RunError::Read {
            path: path.clone(),
            source,
        };
        let file = File::open(&path).map_err(read_error)?;
        let records = Records::new(BufReader::with_capacity(1 << 18, file)).map_err(read_error)?;
        let Some(mut records) = records else {
            return Err(self.not_a_run("it does not begin like an MCAP file".into()));
        };
        while let Some(record) = records.next_record().map_err(read_error)? {
            take(self, record)?;
        }
        Ok(())
    }

    fn not_a_run(&self, reason: String) -> RunError {
        RunError::NotARun {
            path: self.path.clone(),
            reason,
        }
    }
}

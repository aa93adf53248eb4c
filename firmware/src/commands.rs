//! Requests from the host: each is done once and answered as often as it is asked.
//!
//! A request is known by its id together with the check sum of its bytes, so that a host that
//! starts anew with an old id does not get the answer to another question. Requests that change
//! something are remembered; questions are simply answered again.

use crate::board::Board;
use crate::event::Event;
use crate::front_end::{GaugeFrontEnd, JointFrontEnd};
use crate::sensing::wrench::GaugeMatrix;
use crate::store::{self, CalibrationStore};
use palpus_protocol::{
    CRC, Calibration, CalibrationError, CalibrationStored, Command, Frame, FrameError,
    GAUGES_PER_PAGE, HostMessage, MessageError, Outcome, Refusal, Request, StorePlace, Streams,
    TareRequest,
};

/// Requests that are remembered.
const REMEMBERED: usize = 8;

/// An answer on its way; what it says of the board is filled in when it leaves.
// The queue holds a handful of these; boxing would need an allocator.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum PendingReply {
    Identity {
        request_id: u32,
    },
    Statistics {
        request_id: u32,
    },
    GaugeStatistics {
        request_id: u32,
        first: u8,
    },
    Time {
        request_id: u32,
        host_send_us: u64,
        board_receive_us: u64,
    },
    Calibration {
        request_id: u32,
    },
    Outcome {
        request_id: u32,
        outcome: Outcome,
    },
}

/// A request that was done, or is being done while there is no outcome.
#[derive(Clone, Debug)]
struct Remembered {
    request_id: u32,
    fingerprint: u32,
    outcome: Option<Outcome>,
}

/// The last few requests that changed something.
#[derive(Debug)]
pub(crate) struct RecentRequests {
    entries: [Option<Remembered>; REMEMBERED],
    next: usize,
}

impl RecentRequests {
    pub const fn new() -> Self {
        Self {
            entries: [const { None }; REMEMBERED],
            next: 0,
        }
    }

    fn find(&self, request_id: u32, fingerprint: u32) -> Option<&Remembered> {
        self.entries
            .iter()
            .flatten()
            .find(|entry| entry.request_id == request_id && entry.fingerprint == fingerprint)
    }

    fn remember(&mut self, request_id: u32, fingerprint: u32, outcome: Option<Outcome>) {
        if let Some(entry) = self.entries.get_mut(self.next) {
            *entry = Some(Remembered {
                request_id,
                fingerprint,
                outcome,
            });
        }
        self.next = (self.next + 1) % REMEMBERED;
    }

    /// Gives a request that was being done its outcome.
    pub fn settle(&mut self, request_id: u32, outcome: &Outcome) {
        for entry in self.entries.iter_mut().flatten() {
            if entry.request_id == request_id && entry.outcome.is_none() {
                entry.outcome = Some(outcome.clone());
            }
        }
    }
}

/// What a frame from the host turned out to be.
// It lives between reading a frame and acting on it; boxing would need an allocator.
#[allow(clippy::large_enum_variant)]
enum Received {
    Message {
        message: HostMessage,
        fingerprint: u32,
    },
    Damaged(FrameError),
    Unreadable {
        error: MessageError,
    },
}

/// Reads a frame; the fingerprint is of its kind and body.
fn read(frame: Result<Frame<'_>, FrameError>) -> Received {
    match frame {
        Err(error) => Received::Damaged(error),
        Ok(frame) => match HostMessage::try_from(frame) {
            Ok(message) => Received::Message {
                message,
                fingerprint: CRC.checksum(frame.body),
            },
            Err(error) => Received::Unreadable { error },
        },
    }
}

impl<G: GaugeFrontEnd, J: JointFrontEnd, S: CalibrationStore> Board<G, J, S> {
    /// Takes bytes from the host, as many or as few as there are.
    pub fn receive(&mut self, bytes: &[u8], now_us: u64) {
        for &byte in bytes {
            let received = match self.decoder.push(byte) {
                None => continue,
                Some(result) => read(result),
            };
            match received {
                Received::Message {
                    message,
                    fingerprint,
                } => self.obey(message, fingerprint, now_us),
                Received::Damaged(error) => self.note(Event::BadFrame(error), now_us),
                Received::Unreadable { error } => self.refuse_frame(error, now_us),
            }
        }
    }

    fn refuse_frame(&mut self, error: MessageError, now_us: u64) {
        self.frames_refused = self.frames_refused.wrapping_add(1);
        self.note(Event::BadMessage(error), now_us);
        // A host of another version gets the one answer it can read; once, however often it asks.
        let mismatch = matches!(
            error,
            MessageError::Version { .. } | MessageError::Schema { .. }
        );
        let unasked = PendingReply::Identity { request_id: 0 };
        if mismatch && !self.replies.any(|reply| *reply == unasked) {
            self.replies.push(unasked);
        }
    }

    fn obey(&mut self, message: HostMessage, fingerprint: u32, now_us: u64) {
        match message {
            HostMessage::Identify(identify) => {
                self.replies.push(PendingReply::Identity {
                    request_id: identify.request_id,
                });
            }
            HostMessage::Request(Request {
                request_id,
                command,
            }) => {
                match self
                    .recent
                    .find(request_id, fingerprint)
                    .map(|known| known.outcome.clone())
                {
                    None => self.carry_out(request_id, command, fingerprint, now_us),
                    Some(outcome) => {
                        self.requests_repeated = self.requests_repeated.wrapping_add(1);
                        // While it is still being done, the answer comes when it is.
                        if let Some(outcome) = outcome {
                            self.replies.push(PendingReply::Outcome {
                                request_id,
                                outcome,
                            });
                        }
                    }
                }
            }
        }
    }

    fn carry_out(&mut self, request_id: u32, command: Command, fingerprint: u32, now_us: u64) {
        let outcome = match command {
            Command::Ping(number) => {
                self.replies.push(PendingReply::Outcome {
                    request_id,
                    outcome: Outcome::Pong(number),
                });
                return;
            }
            Command::TimeSync(request) => {
                let host_send_us = request.host_send_us;
                self.replies.push(PendingReply::Time {
                    request_id,
                    host_send_us,
                    board_receive_us: now_us,
                });
                return;
            }
            Command::GetCalibration => {
                self.replies.push(PendingReply::Calibration { request_id });
                return;
            }
            Command::Statistics => {
                self.replies.push(PendingReply::Statistics { request_id });
                for first in (0..self.gauges.gauges()).step_by(GAUGES_PER_PAGE) {
                    self.replies.push(PendingReply::GaugeStatistics {
                        request_id,
                        first: first as u8,
                    });
                }
                return;
            }
            Command::Start(streams) => {
                self.streams = streams;
                self.sampling.restart_streams();
                Outcome::Done
            }
            Command::Stop => {
                self.streams = Streams::default();
                Outcome::Done
            }
            Command::Tare(request) => match self.begin_tare(request) {
                Ok(()) => {
                    self.sampling.tare_request_id = Some(request_id);
                    self.recent.remember(request_id, fingerprint, None);
                    return;
                }
                Err(refusal) => Outcome::Refused(refusal),
            },
            Command::SetCalibration(calibration) => self.set_calibration(calibration, now_us),
        };
        if let Outcome::Refused(refusal) = outcome {
            // A refusal is not remembered: the same request may succeed once its reason is gone.
            self.note(
                Event::Refused {
                    request_id,
                    refusal,
                },
                now_us,
            );
        } else {
            self.recent
                .remember(request_id, fingerprint, Some(outcome.clone()));
        }
        self.replies.push(PendingReply::Outcome {
            request_id,
            outcome,
        });
    }

    fn begin_tare(&mut self, request: TareRequest) -> Result<(), Refusal> {
        // Before the first tare the load is not known; then only the settling is judged.
        let load_is_known = self.sampling.tare.is_taken() && self.matrix.is_some();
        if load_is_known && self.sampling.gate.is_loaded() && !request.force {
            return Err(Refusal::InContact);
        }
        self.sampling.tare.begin(request)
    }

    fn set_calibration(&mut self, calibration: Calibration, now_us: u64) -> Outcome {
        if self.streams != Streams::default() {
            return Outcome::Refused(Refusal::Streaming);
        }
        let gauges = self.gauges.gauges();
        let matrix = match GaugeMatrix::new(&calibration, gauges) {
            Ok(matrix) => matrix,
            Err(error) => {
                return Outcome::Refused(match error {
                    CalibrationError::Crc => Refusal::CalibrationCrc,
                    CalibrationError::Shape => Refusal::CalibrationShape(gauges as u8),
                    CalibrationError::NotFinite | CalibrationError::ZeroId => {
                        Refusal::CalibrationValue
                    }
                });
            }
        };
        let id = calibration.id;
        self.calibration_place = match store::save(&mut self.store, &calibration) {
            Ok(()) if self.store.is_permanent() => StorePlace::Permanent,
            Ok(()) => StorePlace::RamOnly,
            Err(error) => {
                self.store_failures = self.store_failures.wrapping_add(1);
                self.note(Event::StoreFailed(error), now_us);
                StorePlace::RamOnly
            }
        };
        self.use_calibration(calibration, matrix);
        self.note(Event::Calibrated { id }, now_us);
        Outcome::CalibrationStored(CalibrationStored {
            id,
            place: self.calibration_place,
        })
    }
}

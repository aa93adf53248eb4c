//! One board, asked by a person: statistics, tare, raw gauges, calibration, how far away it is.
//!
//! Nothing here changes what the board streams but [`raw`], which stops all streams when it ends, and
//! [`store_calibration`], which needs them stopped.

use super::LinkError;
use super::clock::{ClockFilter, ClockFit, RoundTrip, WireTime};
use super::connection::{Connection, GIVE_UP_AFTER, REPEAT_AFTER};
use super::host_clock::HostClock;
use palpus_protocol::{
    BoardMessage, Calibration, CalibrationStored, Command, GaugeCounts, HostMessage, Outcome,
    RawGauges, Refusal, Request, Statistics, Streams, TareRequest, Tared, TimeSyncRequest,
};
use std::time::Duration;

/// A board's counters with those of each gauge.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardStatistics {
    /// The board's own.
    pub board: Statistics,
    /// Those of the gauges, in the front end's order.
    pub gauges: Vec<GaugeCounts>,
}

/// Asks for all counters.
///
/// # Errors
/// [`LinkError`].
pub fn statistics(connection: &mut Connection) -> Result<BoardStatistics, LinkError> {
    let request_id = connection.new_id();
    let message = HostMessage::from(Request {
        request_id,
        command: Command::Statistics,
    });
    let end = connection.clock().instant() + GIVE_UP_AFTER;
    let mut board: Option<Statistics> = None;
    let mut gauges: Vec<Option<GaugeCounts>> = Vec::new();
    while connection.clock().instant() < end {
        connection.send(&message)?;
        let repeat = (connection.clock().instant() + REPEAT_AFTER).min(end);
        while let Some(received) = connection.receive(repeat)? {
            match received.message {
                Ok(BoardMessage::Statistics(found)) if found.request_id == request_id => {
                    gauges.resize(usize::from(found.gauges), None);
                    board = Some(found);
                }
                Ok(BoardMessage::GaugeStatistics(page)) if page.request_id == request_id => {
                    for (counts, place) in page.gauges.iter().zip(usize::from(page.first)..) {
                        if gauges.len() <= place {
                            gauges.resize(place + 1, None);
                        }
                        gauges[place] = Some(*counts);
                    }
                }
                _ => {}
            }
            let whole: Option<Vec<GaugeCounts>> = gauges.iter().copied().collect();
            if let (Some(board), Some(gauges)) = (board, whole)
                && gauges.len() == usize::from(board.gauges)
            {
                return Ok(BoardStatistics { board, gauges });
            }
        }
    }
    connection.check_peer()?;
    Err(no_answer(connection, "statistics"))
}

/// Takes the unloaded gauges' mean over `samples` periods as zero; `force` does so even in contact.
///
/// # Errors
/// [`LinkError::Refused`] with the reason, [`LinkError`].
pub fn tare(connection: &mut Connection, samples: u16, force: bool) -> Result<Tared, LinkError> {
    // Answered when done: at the slowest a sample takes a few periods of 5 ms.
    let patience = GIVE_UP_AFTER + Duration::from_millis(20) * u32::from(samples);
    let command = Command::Tare(TareRequest { samples, force });
    match connection.request(command, patience)? {
        Outcome::Tared(tared) => Ok(tared),
        other => Err(unexpected(connection, "tare", &other)),
    }
}

/// The calibration in use; `None` if the board has none.
///
/// # Errors
/// [`LinkError`].
pub fn calibration(connection: &mut Connection) -> Result<Option<Calibration>, LinkError> {
    match connection.request(Command::GetCalibration, GIVE_UP_AFTER) {
        Ok(Outcome::Calibration(calibration)) => Ok(Some(calibration)),
        Ok(other) => Err(unexpected(connection, "get calibration", &other)),
        Err(LinkError::Refused {
            reason: Refusal::NoCalibration,
            ..
        }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Stops the streams, has the board use and keep a calibration, and reads it back.
///
/// # Errors
/// [`LinkError::Refused`] with the reason, [`LinkError`].
pub fn store_calibration(
    connection: &mut Connection,
    calibration: &Calibration,
) -> Result<CalibrationStored, LinkError> {
    connection.request(Command::Stop, GIVE_UP_AFTER)?;
    // Erasing a flash sector stalls the board for about a second.
    let patience = GIVE_UP_AFTER * 3;
    let command = Command::SetCalibration(calibration.clone());
    let stored = match connection.request(command, patience)? {
        Outcome::CalibrationStored(stored) => stored,
        other => return Err(unexpected(connection, "set calibration", &other)),
    };
    match self::calibration(connection)? {
        Some(kept) if kept == *calibration => Ok(stored),
        kept => Err(LinkError::UnexpectedAnswer {
            port: connection.name().into(),
            asked: "get calibration",
            answer: format!(
                "another calibration than was stored: id {:?}",
                kept.map(|c| c.id)
            ),
        }),
    }
}

/// Streams raw gauges, every `every`-th period, until `take` returns false; then stops all streams.
///
/// # Errors
/// [`LinkError`]; nothing coming for two seconds is [`LinkError::NoAnswer`].
pub fn raw(
    connection: &mut Connection,
    every: u8,
    mut take: impl FnMut(&RawGauges) -> bool,
) -> Result<(), LinkError> {
    let streams = Streams {
        contact_every: 0,
        raw_every: every.max(1),
    };
    connection.request(Command::Start(streams), GIVE_UP_AFTER)?;
    let silence = Duration::from_secs(2);
    let mut last = connection.clock().instant();
    let result = loop {
        match connection.receive(connection.clock().instant() + Duration::from_millis(50)) {
            Ok(Some(received)) => {
                if let Ok(BoardMessage::RawGauges(gauges)) = received.message {
                    last = connection.clock().instant();
                    if !take(&gauges) {
                        break Ok(());
                    }
                }
            }
            Ok(None) if connection.clock().instant().saturating_duration_since(last) > silence => {
                break Err(no_answer(connection, "raw gauges"));
            }
            Ok(None) => {}
            Err(error) => break Err(error),
        }
    };
    result.and(connection.request(Command::Stop, GIVE_UP_AFTER).map(drop))
}

/// Mean tared counts of each gauge over `samples` good readings, and their standard deviation.
///
/// # Errors
/// [`LinkError`].
pub fn mean_counts(
    connection: &mut Connection,
    samples: usize,
) -> Result<Vec<(f64, f64)>, LinkError> {
    let mut sums: Vec<(f64, f64, f64)> = Vec::new();
    let (mut taken, mut seen) = (0, 0);
    raw(connection, 1, |gauges| {
        seen += 1;
        if gauges.gauges.iter().all(|g| g.flags.is_good()) {
            sums.resize(gauges.gauges.len(), (0.0, 0.0, 0.0));
            for (sum, gauge) in sums.iter_mut().zip(&gauges.gauges) {
                let counts = f64::from(gauge.tared_counts);
                *sum = (sum.0 + 1.0, sum.1 + counts, sum.2 + counts * counts);
            }
            taken += 1;
        }
        // A gauge that never reads well must not keep one waiting for ever.
        taken < samples && seen < 10 * samples + 100
    })?;
    if taken < samples {
        return Err(LinkError::UnexpectedAnswer {
            port: connection.name().into(),
            asked: "raw gauges",
            answer: format!(
                "{taken} good readings of {seen}; see `palpus board {} stats`",
                connection.name()
            ),
        });
    }
    Ok(sums
        .into_iter()
        .map(|(n, sum, squares)| {
            let mean = sum / n;
            (mean, (squares / n - mean * mean).max(0.0).sqrt())
        })
        .collect())
}

/// Time from a ping to its answer.
///
/// # Errors
/// [`LinkError`].
pub fn ping(connection: &mut Connection, number: u32) -> Result<Duration, LinkError> {
    let start = connection.clock().instant();
    match connection.request(Command::Ping(number), GIVE_UP_AFTER)? {
        Outcome::Pong(answer) if answer == number => Ok(connection
            .clock()
            .instant()
            .saturating_duration_since(start)),
        other => Err(unexpected(connection, "ping", &other)),
    }
}

/// Compares clocks `count` times, `pause` apart, and returns the alignment with every round trip.
///
/// # Errors
/// [`LinkError`].
pub fn compare_clocks(
    connection: &mut Connection,
    clock: HostClock,
    wire: WireTime,
    count: usize,
    pause: Duration,
) -> Result<(Option<ClockFit>, Vec<RoundTrip>), LinkError> {
    let mut filter = ClockFilter::new();
    let mut trips = Vec::new();
    for _ in 0..count {
        let request_id = connection.new_id();
        let message = HostMessage::from(Request {
            request_id,
            command: Command::TimeSync(TimeSyncRequest {
                host_send_us: clock.running_us(),
            }),
        });
        let sent_us = clock.now_us();
        let bytes = connection.send(&message)?;
        let end = connection.clock().instant() + GIVE_UP_AFTER;
        let mut found = None;
        // Not repeated: the answer to a repeated request could not be told from the first one's.
        while let Some(received) = connection.receive(end)? {
            if let Ok(BoardMessage::Reply(reply)) = &received.message
                && reply.request_id == request_id
                && let Outcome::Time(answer) = reply.outcome
            {
                found = Some((answer, received.at_us, received.wire.len() + 1));
                break;
            }
        }
        let Some((answer, received_us, answer_bytes)) = found else {
            connection.check_peer()?;
            return Err(no_answer(connection, "time sync"));
        };
        let board = |us: u64| i64::try_from(us).unwrap_or(i64::MAX);
        let trip = RoundTrip {
            sent_us: sent_us + wire.of(bytes),
            board_received_us: board(answer.board_receive_us),
            board_sent_us: board(answer.board_send_us),
            received_us: received_us - wire.of(answer_bytes),
        };
        filter.add(trip);
        trips.push(trip);
        std::thread::sleep(pause);
    }
    Ok((filter.fit().copied(), trips))
}

fn no_answer(connection: &Connection, asked: &'static str) -> LinkError {
    let counts = connection.counts();
    LinkError::NoAnswer {
        port: connection.name().into(),
        asked,
        waited: GIVE_UP_AFTER,
        bytes: counts.bytes,
        bad: counts.bad,
    }
}

fn unexpected(connection: &Connection, asked: &'static str, outcome: &Outcome) -> LinkError {
    LinkError::UnexpectedAnswer {
        port: connection.name().into(),
        asked,
        answer: format!("{outcome:?}"),
    }
}

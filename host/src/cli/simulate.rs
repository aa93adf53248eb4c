//! `palpus simulate`: a simulated hand on pseudo-terminals, or its tracks alone as a point file.

use super::{Common, Exit, Failure, interruption, outputs, say};
use anyhow::{Context, anyhow};
use palpus_host::cloud::write_ply;
use palpus_host::export::{sampled_from_mesh, write_bytes, write_mesh};
use palpus_host::hand::Hand;
use palpus_host::import::read_mesh;
use palpus_host::simulate::{HandOptions, Noise, Object, PointSet, SimulateError, SimulatedHand};
use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Longest side given to an object that comes from a mesh file without `--size`, millimetres.
const MESH_SIDE_MM: f64 = 150.0;

/// What the simulated hand is like, for every command that has one.
#[derive(Debug, clap::Args)]
pub struct HandArgs {
    /// Everything random follows from this.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Fingers to use, 1 to 3.
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub fingers: usize,
    /// Imperfection of gauges and encoders: none, default, or how many times the default.
    #[arg(long, value_name = "none|default|FACTOR", default_value = "default", value_parser = noise)]
    pub noise: Noise,
    /// Contacts in which the whole object is gone over once, at 200 Hz a finger; decides how fast the fingers slide.
    #[arg(long, value_name = "N", default_value_t = 6000)]
    pub contacts: usize,
    /// How much faster than 200 Hz the boards sample and the fingers move.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub speed: f64,
}

impl HandArgs {
    /// Such a hand at the object.
    pub fn at(&self, object: Object) -> HandOptions {
        let mut options = HandOptions::new(object);
        options.fingers = self.fingers;
        options.noise = self.noise;
        options.contacts = self.contacts;
        options.speed = self.speed;
        options.seed = self.seed;
        options
    }
}

/// Arguments of `palpus simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  palpus simulate --object torus --write-hand hand.urdf
      boards on pseudo-terminals, until Ctrl-C; prints how to capture them
  palpus simulate --object mug --points 1229 --seed 1 -o mug.ply
      the tracks alone, as a point file
  palpus simulate --object mug --points 1229 --position-noise 0.5 --normal-noise 3 -o noisy.ply --truth mug.stl
      with noise, and the true shape to evaluate against")]
pub struct Args {
    /// What to touch: sphere, ellipsoid, torus, two-holed-torus, mug, bowl, bean, trilobe, cube, cylinder, or a
    /// closed mesh file (.ply, .obj, .stl).
    #[arg(long, value_name = "NAME|FILE")]
    object: String,
    /// Longest side of an object from a mesh file, in millimetres [default: 150].
    #[arg(long, value_name = "MM")]
    size: Option<f64>,
    #[command(flatten)]
    hand: HandArgs,
    /// Normal force, in newtons.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 2.0,
        conflicts_with = "points"
    )]
    force: f64,
    /// Tangential over normal force while sliding.
    #[arg(
        long,
        value_name = "MU",
        default_value_t = 0.3,
        conflicts_with = "points"
    )]
    friction: f64,
    /// Largest moment about the contact's normal, in newton millimetres.
    #[arg(
        long,
        value_name = "NMM",
        default_value_t = 1.0,
        conflicts_with = "points"
    )]
    spin: f64,
    /// Stop by itself after so many seconds.
    #[arg(long, value_name = "S", conflicts_with = "points")]
    duration: Option<f64>,
    /// Stop by itself once the whole object has been gone over so often.
    #[arg(long, value_name = "N", conflicts_with = "points")]
    rounds: Option<u64>,
    /// Write the description of the simulated hand, for `palpus capture --hand`.
    #[arg(long, value_name = "URDF", conflicts_with = "points")]
    write_hand: Option<PathBuf>,
    /// Write the object's true shape as a mesh, for `palpus evaluate --against`.
    #[arg(long, value_name = "MESH")]
    truth: Option<PathBuf>,
    /// Make this many points of the tracks at once, without boards, and write them to -o.
    #[arg(long, value_name = "N", requires = "output", conflicts_with_all = ["fingers", "noise", "contacts", "speed"])]
    points: Option<usize>,
    /// Where to write the points (.ply).
    #[arg(short, long, value_name = "FILE", requires = "points")]
    output: Option<PathBuf>,
    /// With --points: touch one sector only and repeat it this often by rotation about the z axis.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "points")]
    copies: usize,
    /// With --points: scale the result so that the object's longest side has this length.
    #[arg(long, value_name = "LENGTH", requires = "points")]
    longest_side: Option<f64>,
    /// With --points: standard deviation of the positions per axis, in the result's unit.
    #[arg(long, value_name = "SIGMA", default_value_t = 0.0, requires = "points")]
    position_noise: f64,
    /// With --points: root mean square angle by which normals are turned, in degrees.
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 0.0,
        requires = "points"
    )]
    normal_noise: f64,
}

/// Runs `palpus simulate`.
pub fn run(common: &Common, args: Args) -> Result<Exit, Failure> {
    for (name, value) in [
        ("--size", args.size),
        ("--longest-side", args.longest_side),
        ("--duration", args.duration),
    ] {
        if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
            let error = anyhow!("{name} {value}: a number above 0 is needed");
            return Err(Failure::new(Exit::Usage, error));
        }
    }
    for (name, value) in [
        ("--position-noise", args.position_noise),
        ("--normal-noise", args.normal_noise),
    ] {
        if !(value.is_finite() && value >= 0.0) {
            let error = anyhow!("{name} {value}: a number of at least 0 is needed");
            return Err(Failure::new(Exit::Usage, error));
        }
    }
    for path in [&args.output, &args.truth, &args.write_hand]
        .into_iter()
        .flatten()
    {
        outputs::check_file(path)?;
    }
    let object = object(&args.object, args.size)?;
    if let Some(path) = &args.truth {
        let mut mesh = object.truth_mesh();
        if let (Some(side), Some((low, high))) = (args.longest_side, mesh.bounding_box()) {
            let scale = side / (high - low).max();
            mesh.positions.iter_mut().for_each(|p| *p *= scale);
        }
        write_mesh(path, &sampled_from_mesh(&mesh)).map_err(|e| Failure::new(Exit::Usage, e))?;
    }
    match (args.points, &args.output) {
        (Some(count), Some(output)) => {
            let set = PointSet {
                count,
                copies: args.copies,
                longest_side: args.longest_side,
                position_noise: args.position_noise,
                normal_noise_degrees: args.normal_noise,
                seed: args.hand.seed,
                ..PointSet::default()
            };
            let cloud = set.points(&object);
            let mut bytes = Vec::new();
            write_ply(&cloud, &mut bytes)
                .context("the points cannot be encoded")
                .map_err(|e| Failure::new(Exit::Usage, e))?;
            write_bytes(output, &bytes).map_err(|e| Failure::new(Exit::Usage, e))?;
            if common.json {
                let value = serde_json::json!({ "object": object.name(), "points": cloud.points.len(), "file": output });
                say::out(&format!("{value}\n"));
            }
            Ok(Exit::Done)
        }
        _ => boards(common, &args, object),
    }
}

/// Runs the boards until told to stop.
fn boards(common: &Common, args: &Args, object: Object) -> Result<Exit, Failure> {
    if let Some(path) = &args.write_hand {
        write_bytes(path, Hand::THREE_FINGER_URDF.as_bytes())
            .map_err(|e| Failure::new(Exit::Usage, e))?;
    }
    let mut options = args.hand.at(object);
    options.normal_force_n = args.force;
    options.friction = args.friction;
    options.spin_n_mm = args.spin;

    let stop = interruption()?;
    let hand = SimulatedHand::start(&options).map_err(|e| Failure::new(exit_of(&e), e))?;
    print_ports(common, args, &hand);

    let began = Instant::now();
    let mut exit = Exit::Done;
    loop {
        if stop.load(Ordering::Relaxed) {
            // Stopping is how this command ends; with an end of its own it was interrupted.
            if args.duration.is_some() || args.rounds.is_some() {
                exit = Exit::Interrupted;
            }
            break;
        }
        let time_is_up = args
            .duration
            .is_some_and(|seconds| began.elapsed().as_secs_f64() >= seconds);
        if time_is_up || args.rounds.is_some_and(|rounds| hand.rounds() >= rounds) {
            break;
        }
        if hand.has_failed() {
            let error = anyhow!("a pseudo-terminal was taken away; start the simulation again");
            return Err(Failure::new(Exit::Device, error));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    hand.stop();
    Ok(exit)
}

/// Which code a failed simulation leaves with.
pub fn exit_of(error: &SimulateError) -> Exit {
    match error {
        SimulateError::Fingers { .. } | SimulateError::Option { .. } => Exit::Usage,
        SimulateError::OutOfReach { .. } | SimulateError::Hand(_) => Exit::Input,
        SimulateError::Board { .. } | SimulateError::Terminal { .. } => Exit::Device,
    }
}

fn print_ports(common: &Common, args: &Args, hand: &SimulatedHand) {
    if common.json {
        let fingers: Vec<serde_json::Value> = hand
            .ports()
            .iter()
            .map(|p| serde_json::json!({ "finger": p.finger, "port": p.port }))
            .collect();
        let value = serde_json::json!({
            "object": args.object, "fingers": fingers, "hand": args.write_hand,
            "touchable": hand.touchable(), "unreachable": hand.unreachable(),
            "slide_mm_per_s": hand.slide_mm_per_s(),
        });
        say::out(&format!("{value}\n"));
        return;
    }
    for port in hand.ports() {
        say::out(&format!("{}={}\n", port.finger, port.port.display()));
    }
    if std::io::stderr().is_terminal() || common.verbose > 0 {
        let file = args
            .write_hand
            .as_ref()
            .map_or_else(|| "HAND.urdf".into(), |p| p.display().to_string());
        let fingers: String = hand
            .ports()
            .iter()
            .map(|p| format!(" --finger {}={}", p.finger, p.port.display()))
            .collect();
        say::err(&format!(
            "{:.1} % of the surface can be touched, {:.1} % of that is out of reach; sliding at {:.0} mm/s.\n\
             Record it with:\n  palpus capture{fingers} --hand {file} -o RUN.mcap\nStop with Ctrl-C.",
            100.0 * hand.touchable(),
            100.0 * hand.unreachable(),
            hand.slide_mm_per_s(),
        ));
        if args.write_hand.is_none() {
            say::err("(--write-hand HAND.urdf writes the hand's description.)");
        }
    }
}

/// Reads `--noise`.
pub fn noise(text: &str) -> Result<Noise, String> {
    match text {
        "none" => Ok(Noise::none()),
        "default" => Ok(Noise::standard()),
        factor => match factor.parse::<f64>() {
            Ok(factor) if (0.01..=100.0).contains(&factor) => Ok(Noise::scaled(factor)),
            _ => Err("give none, default, or a factor from 0.01 to 100".into()),
        },
    }
}

/// The known name that is most like `name`, if any is: at most a third of its letters have to be changed.
fn nearest<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let apart = |a: &str, b: &str| {
        let b: Vec<char> = b.chars().collect();
        let mut row: Vec<usize> = (0..=b.len()).collect();
        let mut before: Vec<usize> = Vec::new();
        let mut last = None;
        for (i, x) in a.chars().enumerate() {
            let mut next = vec![i + 1];
            for (j, y) in b.iter().enumerate() {
                let mut cost = (row[j] + usize::from(x != *y))
                    .min(row[j + 1] + 1)
                    .min(next[j] + 1);
                // Two neighbours in the wrong order are one slip.
                if j > 0 && last == Some(*y) && b[j - 1] == x {
                    cost = cost.min(before[j - 1] + 1);
                }
                next.push(cost);
            }
            last = Some(x);
            before = std::mem::replace(&mut row, next);
        }
        row[b.len()]
    };
    let name = name.to_lowercase();
    known
        .iter()
        .map(|known| (apart(&name, known), *known))
        .filter(|(apart, known)| 3 * apart <= known.len().max(3))
        .min()
        .map(|(_, known)| known)
}

/// The object of that name, or of that file.
pub fn object(name: &str, size_mm: Option<f64>) -> Result<Object, Failure> {
    let refused = |e: anyhow::Error| Failure::new(Exit::Input, e);
    if Object::NAMES.contains(&name) {
        if size_mm.is_some() {
            let error = anyhow!("--size is for mesh files; {name} has its own size");
            return Err(Failure::new(Exit::Usage, error));
        }
        return Object::named(name).map_err(|e| refused(e.into()));
    }
    let path = PathBuf::from(name);
    if !path.exists() {
        // The message lists the names there are.
        return Object::named(name).map_err(|e| {
            let near = nearest(name, &Object::NAMES);
            let hint = near.map_or(String::new(), |near| format!("; did you mean `{near}`?"));
            Failure::new(Exit::Usage, anyhow!("{e}{hint}"))
        });
    }
    let mesh = read_mesh(&path).map_err(|e| refused(e.into()))?;
    Object::from_mesh(name, &mesh, Some(size_mm.unwrap_or(MESH_SIDE_MM)))
        .map_err(|e| refused(e.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_find_the_name_that_was_meant() {
        for (slip, meant) in [
            ("torsu", Some("torus")),
            ("Mug", Some("mug")),
            ("spere", Some("sphere")),
            ("two-holed-tours", Some("two-holed-torus")),
            ("cylnder", Some("cylinder")),
            ("teapot", None),
            ("", None),
        ] {
            assert_eq!(nearest(slip, &Object::NAMES), meant, "{slip}");
        }
    }
}

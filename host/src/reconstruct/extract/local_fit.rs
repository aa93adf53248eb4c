//! One local field: a Gaussian process on a few dozen contacts, with positions and normals as data.
//!
//! Model: f is a random function whose covariance is `tau^2 phi` plus a free polynomial; at a contact f = 0
//! up to the position's standard deviation, and the gradient of f is the measured normal up to the normal's.
//! The posterior mean is the Hermite spline of Wendland (2005, chapter 16) with smoothing weights that are
//! the noise variances themselves, so they can be judged by the restricted likelihood (polynomials
//! projected out; Wahba 1985, Mardia et al. 1996). All data are divided by their standard deviation first:
//! the system is `tau^2 A + I` on the complement of the polynomials, always positive definite.
//!
//! Coordinates are local: the contacts lie in the unit ball. Lengths and field values scale with the radius,
//! gradients do not.

use faer::{
    Mat, Par, Spec,
    dyn_stack::{MemBuffer, MemStack},
    linalg::cholesky::llt::factor as cholesky,
    linalg::triangular_inverse,
};

use pulp::{Arch, NullaryFnOnce};

use super::{dense::Dense, kernel::Kernel, orthogonal::Orthogonal};
use crate::Vec3;

/// Weight that holds polynomial terms the data cannot fix (a plane says nothing of z^3): a prior standard
/// deviation of 1 / RIDGE on each coefficient, ten times the curvature of the unit ball. Data of any use
/// outweigh it by orders of magnitude.
const RIDGE: f64 = 0.1;

/// The contacts of a local fit in local coordinates, with standard deviations.
pub(super) struct Contacts {
    /// Positions in the unit ball.
    pub nodes: Vec<Vec3>,
    /// Measured unit normals.
    pub normals: Vec<Vec3>,
    /// Standard deviation of each position along the normal, in local units.
    pub position_sigma: Vec<f64>,
    /// Standard deviation of each component of each normal.
    pub normal_sigma: Vec<f64>,
}

/// The local problem with the polynomials projected out, before the smoothness `tau^2` is chosen.
pub(super) struct LocalProblem {
    kernel: Kernel,
    contacts: Contacts,
    /// 1 / standard deviation of each datum (value, then three gradient components, per contact).
    weight: Vec<f64>,
    polynomials: Orthogonal,
    /// `Q^T K Q` of the weighted kernel matrix, its lower triangle.
    projected: Dense,
    /// `Q^T y` of the weighted data.
    data: Vec<f64>,
}

impl LocalProblem {
    /// Assembles and projects. The kernel is made simpler while the contacts are too few for its polynomials.
    pub(super) fn new(kernel: Kernel, contacts: Contacts) -> Self {
        let count = contacts.nodes.len();
        let mut kernel = kernel;
        while 4 * count < 2 * kernel.terms() {
            match kernel.simpler() {
                Some(simpler) => kernel = simpler,
                None => break,
            }
        }
        let n = 4 * count;
        let weight: Vec<f64> = (0..count)
            .flat_map(|i| {
                let (v, g) = (
                    1.0 / contacts.position_sigma[i],
                    1.0 / contacts.normal_sigma[i],
                );
                [v, g, g, g]
            })
            .collect();
        let mut terms = Mat::<f64>::zeros(n, kernel.terms());
        for (i, node) in contacts.nodes.iter().enumerate() {
            let (value, gradient) = kernel.monomials(node);
            for t in 0..kernel.terms() {
                terms[(4 * i, t)] = value[t] * weight[4 * i];
                for c in 0..3 {
                    terms[(4 * i + 1 + c, t)] = gradient[t][c] * weight[4 * i + 1 + c];
                }
            }
        }
        let polynomials = Orthogonal::new(terms);
        let mut projected = Arch::new().dispatch(Covariance {
            kernel,
            nodes: &contacts.nodes,
            weight: &weight,
        });
        polynomials.conjugate(&mut projected);
        let mut data: Vec<f64> = contacts
            .normals
            .iter()
            .flat_map(|m| [0.0, m.x, m.y, m.z])
            .zip(&weight)
            .map(|(y, w)| y * w)
            .collect();
        polynomials.apply_transposed(&mut data);
        Self {
            kernel,
            contacts,
            weight,
            polynomials,
            projected,
            data,
        }
    }

    /// The kernel in use.
    pub(super) fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// Lower Cholesky factor of `tau^2 A + I`; what stands above its diagonal means nothing.
    fn factor(&self, tau2: f64) -> Option<Dense> {
        let rank = self.polynomials.rank();
        let m = self.projected.rows() - rank;
        let mut system = Dense::unwritten(m, m);
        for j in 0..m {
            let below = &mut system.column_mut(j)[j..];
            let known = &self.projected.column(rank + j)[rank + j..];
            for (x, a) in below.iter_mut().zip(known) {
                *x = a * tau2;
            }
            below[0] += 1.0;
        }
        let need = cholesky::cholesky_in_place_scratch::<f64>(m, Par::Seq, Spec::default());
        cholesky::cholesky_in_place(
            system.view_mut(),
            cholesky::LltRegularization::default(),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(need)),
            Spec::default(),
        )
        .ok()
        .map(|_| system)
    }

    /// Solves `L u = b` for the reduced data.
    fn forward(&self, factor: &Dense) -> Mat<f64> {
        let rest = &self.data[self.polynomials.rank()..];
        let mut u = Mat::from_fn(rest.len(), 1, |i, _| rest[i]);
        faer::linalg::triangular_solve::solve_lower_triangular_in_place(
            factor.view(),
            u.as_mut(),
            Par::Seq,
        );
        u
    }

    /// Negative restricted log likelihood up to a constant that depends on nothing but the contacts' noise.
    pub(super) fn evidence(&self, tau2: f64) -> Option<f64> {
        let factor = self.factor(tau2)?;
        let u = self.forward(&factor);
        let quadratic: f64 = u.col(0).iter().map(|x| x * x).sum();
        let logarithm: f64 = (0..factor.rows()).map(|i| factor.column(i)[i].ln()).sum();
        Some(0.5 * quadratic + logarithm).filter(|e| e.is_finite())
    }

    /// The posterior mean for the smoothness `tau2`.
    pub(super) fn solve(&self, tau2: f64) -> Option<LocalField> {
        let factor = self.factor(tau2)?;
        let mut z = self.forward(&factor);
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            factor.view().transpose(),
            z.as_mut(),
            Par::Seq,
        );
        let rank = self.polynomials.rank();
        let top: Vec<f64> = (0..rank)
            .map(|i| {
                let across = &self.projected.column(i)[rank..];
                let known: f64 = across.iter().zip(z.col(0).iter()).map(|(a, z)| a * z).sum();
                self.data[i] - tau2 * known
            })
            .collect();
        let mut alpha = vec![0.0; self.data.len()];
        for j in 0..z.nrows() {
            alpha[rank + j] = z[(j, 0)];
        }
        self.polynomials.apply(&mut alpha);
        let coefficients: Vec<[f64; 4]> = alpha
            .chunks_exact(4)
            .zip(self.weight.chunks_exact(4))
            .map(|(a, w)| std::array::from_fn(|c| tau2 * a[c] * w[c]))
            .collect();
        let polynomial = self.polynomials.coefficients(&top, RIDGE);
        let finite = coefficients
            .iter()
            .flatten()
            .chain(&polynomial)
            .all(|x| x.is_finite());
        finite.then(|| LocalField {
            kernel: self.kernel,
            blocks: (self.contacts.nodes.chunks(LANES))
                .zip(coefficients.chunks(LANES))
                .map(|(nodes, coefficients)| Block::of(nodes, coefficients))
                .collect(),
            polynomial,
            centre_variance: self.centre_variance(&factor, tau2),
        })
    }

    /// Posterior variance of the value at the origin: that of the best unbiased estimate u^T y, where u solves the
    /// kriging system with the polynomials as constraints.
    fn centre_variance(&self, factor: &Dense, tau2: f64) -> f64 {
        let rank = self.polynomials.rank();
        let n = self.data.len();
        let mut cross: Vec<f64> = self
            .contacts
            .nodes
            .iter()
            .flat_map(|node| {
                // d = 0 - node: covariance of the value there with value and gradient here.
                let r = self.kernel.radial(node.norm_squared());
                [r.value, r.a * node.x, r.a * node.y, r.a * node.z]
            })
            .zip(&self.weight)
            .map(|(k, w)| tau2 * k * w)
            .collect();
        self.polynomials.apply_transposed(&mut cross);
        let mut constant = vec![0.0; self.kernel.terms()];
        constant[0] = 1.0;
        let u = self.polynomials.transposed_solve(&constant);
        let mut rest = Mat::from_fn(n - rank, 1, |i, _| {
            let known: f64 = (0..rank)
                .map(|j| self.projected.column(j)[rank + i] * u[j])
                .sum();
            cross[rank + i] - tau2 * known
        });
        let top: Vec<f64> = (0..rank)
            .map(|i| {
                let entry = |j: usize| self.projected.column(i.min(j))[i.max(j)];
                (0..rank).map(|j| entry(j) * u[j]).sum()
            })
            .collect();
        faer::linalg::triangular_solve::solve_lower_triangular_in_place(
            factor.view(),
            rest.as_mut(),
            Par::Seq,
        );
        // u^T (tau^2 A + I) u - 2 u^T b, split at the rank: C u_2 = b_2 - tau^2 A_21 u_1, and |L^-1 C u_2|^2 = u_2^T C u_2.
        let lower: f64 = rest.col(0).iter().map(|x| x * x).sum();
        let upper: f64 = (0..rank)
            .map(|i| u[i] * (tau2 * top[i] + u[i] - 2.0 * cross[i]))
            .sum();
        (upper - lower).max(0.0)
    }

    /// Deviation of each datum from what all others say, in standard deviations (value, then gradient, per contact),
    /// from the diagonal of the projected inverse (Rasmussen and Williams 2006, section 5.4.2).
    pub(super) fn leave_one_out(&self, tau2: f64) -> Option<Vec<[f64; 4]>> {
        let factor = self.factor(tau2)?;
        let mut z = self.forward(&factor);
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            factor.view().transpose(),
            z.as_mut(),
            Par::Seq,
        );
        let rank = self.polynomials.rank();
        let mut alpha = vec![0.0; self.data.len()];
        for j in 0..z.nrows() {
            alpha[rank + j] = z[(j, 0)];
        }
        self.polynomials.apply(&mut alpha);
        let mut inverse = Mat::<f64>::zeros(z.nrows(), z.nrows());
        triangular_inverse::invert_lower_triangular(inverse.as_mut(), factor.view(), Par::Seq);
        let half = self.polynomials.complete_right(&inverse);
        let precision: Vec<f64> = (0..half.ncols())
            .map(|j| half.col(j).iter().map(|x| x * x).sum())
            .collect();
        let count = self.contacts.nodes.len();
        let deviation = (0..count)
            .map(|i| {
                std::array::from_fn(|c| {
                    let p = precision[4 * i + c];
                    // Without any redundancy the others say nothing about this datum.
                    if p > 1e-9 {
                        alpha[4 * i + c] / p.sqrt()
                    } else {
                        0.0
                    }
                })
            })
            .collect();
        Some(deviation)
    }
}

/// The weighted kernel matrix of values and gradients at the nodes, in full; made for each kind of processor.
struct Covariance<'a> {
    kernel: Kernel,
    nodes: &'a [Vec3],
    weight: &'a [f64],
}

impl NullaryFnOnce for Covariance<'_> {
    type Output = Dense;

    #[inline(always)]
    fn call(self) -> Dense {
        let Self {
            kernel,
            nodes,
            weight,
        } = self;
        let n = 4 * nodes.len();
        let mut k = Dense::unwritten(n, n);
        for j in 0..nodes.len() {
            for i in j..nodes.len() {
                let d = nodes[i] - nodes[j];
                let r = kernel.radial(d.norm_squared());
                let (wi, wj) = (&weight[4 * i..4 * i + 4], &weight[4 * j..4 * j + 4]);
                let mut block = [[0.0; 4]; 4];
                block[0][0] = r.value;
                for a in 0..3 {
                    block[0][a + 1] = -r.a * d[a];
                    block[a + 1][0] = r.a * d[a];
                    for b in 0..3 {
                        block[a + 1][b + 1] = -r.b * d[a] * d[b];
                    }
                    block[a + 1][a + 1] -= r.a;
                }
                for (b, wb) in wj.iter().enumerate() {
                    let below = &mut k.column_mut(4 * j + b)[4 * i..4 * i + 4];
                    for (a, x) in below.iter_mut().enumerate() {
                        *x = block[a][b] * wi[a] * wb;
                    }
                }
                for (a, wa) in wi.iter().enumerate() {
                    let right = &mut k.column_mut(4 * i + a)[4 * j..4 * j + 4];
                    for (b, x) in right.iter_mut().enumerate() {
                        *x = block[a][b] * wa * wj[b];
                    }
                }
            }
        }
        k
    }
}

/// Nodes that are worked on side by side.
const LANES: usize = 8;

/// So many nodes with their coefficients (of the kernel and of its three derivatives), coordinate by coordinate; nodes
/// that fill up the last block have coefficients 0.
#[derive(Clone, Copy, Debug)]
struct Block {
    node: [[f64; LANES]; 3],
    coefficient: [[f64; LANES]; 4],
}

impl Block {
    fn of(nodes: &[Vec3], coefficients: &[[f64; 4]]) -> Self {
        let lanes = |of: &dyn Fn(usize) -> f64| {
            std::array::from_fn(|l| if l < nodes.len() { of(l) } else { 0.0 })
        };
        Self {
            node: std::array::from_fn(|axis| lanes(&|l| nodes[l][axis])),
            coefficient: std::array::from_fn(|c| lanes(&|l| coefficients[l][c])),
        }
    }

    /// Adds to `f` and `g` what each lane's node gives to value and gradient at `x`.
    #[inline(always)]
    fn add(&self, kernel: Kernel, x: &Vec3, f: &mut [f64; LANES], g: &mut [[f64; LANES]; 3]) {
        let mut d = [[0.0; LANES]; 3];
        for axis in 0..3 {
            for l in 0..LANES {
                d[axis][l] = x[axis] - self.node[axis][l];
            }
        }
        let [w, u, v, t] = &self.coefficient;
        for l in 0..LANES {
            let (dx, dy, dz) = (d[0][l], d[1][l], d[2][l]);
            let r = kernel.radial(dx * dx + dy * dy + dz * dz);
            let along = u[l] * dx + v[l] * dy + t[l] * dz;
            f[l] += r.value * w[l] - r.a * along;
            let way = r.a * w[l] - r.b * along;
            g[0][l] += way * dx - r.a * u[l];
            g[1][l] += way * dy - r.a * v[l];
            g[2][l] += way * dz - r.a * t[l];
        }
    }

    /// Adds to `f` what each lane's node gives to the value at `x`.
    #[inline(always)]
    fn add_value(&self, kernel: Kernel, x: &Vec3, f: &mut [f64; LANES]) {
        let [w, u, v, t] = &self.coefficient;
        for l in 0..LANES {
            let [dx, dy, dz] = std::array::from_fn(|axis| x[axis] - self.node[axis][l]);
            let r = kernel.radial(dx * dx + dy * dy + dz * dz);
            let along = u[l] * dx + v[l] * dy + t[l] * dz;
            f[l] += r.value * w[l] - r.a * along;
        }
    }
}

/// The lanes' sum, in one fixed order.
fn total(lanes: &[f64; LANES]) -> f64 {
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

/// A solved local field in local coordinates.
#[derive(Clone, Debug)]
pub(super) struct LocalField {
    kernel: Kernel,
    blocks: Vec<Block>,
    polynomial: Vec<f64>,
    /// Posterior variance of the value at the origin.
    pub centre_variance: f64,
}

impl LocalField {
    /// Value at `x` (local coordinates and units).
    pub(super) fn value(&self, x: &Vec3) -> f64 {
        let (terms, _) = self.kernel.monomials(x);
        let polynomial: f64 = self.polynomial.iter().zip(&terms).map(|(c, t)| c * t).sum();
        polynomial + total(&Arch::new().dispatch(Values { field: self, x }))
    }

    /// Value and gradient at `x` (local coordinates; the gradient needs no scaling).
    pub(super) fn value_and_gradient(&self, x: &Vec3) -> (f64, Vec3) {
        let (terms, slopes) = self.kernel.monomials(x);
        let (f, g) = Arch::new().dispatch(Jets { field: self, x });
        let mut value = total(&f);
        let mut gradient = Vec3::from_fn(|axis, _| total(&g[axis]));
        for (t, c) in self.polynomial.iter().enumerate() {
            value += c * terms[t];
            gradient += *c * Vec3::from(slopes[t]);
        }
        (value, gradient)
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.blocks.len() * size_of::<Block>() + self.polynomial.len() * 8
    }
}

/// What the nodes give to the value, lane by lane; made for each kind of processor. The kernel is handed in as a constant,
/// so that the loops hold no branch; they are written out, because a closure that is not inlined is made for the least
/// processor.
struct Values<'a> {
    field: &'a LocalField,
    x: &'a Vec3,
}

impl NullaryFnOnce for Values<'_> {
    type Output = [f64; LANES];

    #[inline(always)]
    fn call(self) -> Self::Output {
        let mut f = [0.0; LANES];
        let blocks = &self.field.blocks;
        match self.field.kernel {
            Kernel::Cubic => {
                for b in blocks {
                    b.add_value(Kernel::Cubic, self.x, &mut f);
                }
            }
            Kernel::Quintic => {
                for b in blocks {
                    b.add_value(Kernel::Quintic, self.x, &mut f);
                }
            }
            Kernel::Septic => {
                for b in blocks {
                    b.add_value(Kernel::Septic, self.x, &mut f);
                }
            }
        }
        f
    }
}

/// The same for the value and the gradient.
struct Jets<'a> {
    field: &'a LocalField,
    x: &'a Vec3,
}

impl NullaryFnOnce for Jets<'_> {
    type Output = ([f64; LANES], [[f64; LANES]; 3]);

    #[inline(always)]
    fn call(self) -> Self::Output {
        let (mut f, mut g) = ([0.0; LANES], [[0.0; LANES]; 3]);
        let blocks = &self.field.blocks;
        match self.field.kernel {
            Kernel::Cubic => {
                for b in blocks {
                    b.add(Kernel::Cubic, self.x, &mut f, &mut g);
                }
            }
            Kernel::Quintic => {
                for b in blocks {
                    b.add(Kernel::Quintic, self.x, &mut f, &mut g);
                }
            }
            Kernel::Septic => {
                for b in blocks {
                    b.add(Kernel::Septic, self.x, &mut f, &mut g);
                }
            }
        }
        (f, g)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn contacts(count: usize, sigma: f64) -> Contacts {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(9);
        let mut uniform = move || 2.0 * random.random::<f64>() - 1.0;
        let (mut nodes, mut normals) = (Vec::new(), Vec::new());
        for _ in 0..count {
            let (x, y) = (0.6 * uniform(), 0.6 * uniform());
            let z = 0.3 * x * x - 0.2 * y * y * y + sigma * uniform();
            nodes.push(Vec3::new(x, y, z));
            normals.push(Vec3::new(-0.6 * x, 0.6 * y * y, 1.0).normalize());
        }
        Contacts {
            position_sigma: vec![sigma.max(1e-6); count],
            normal_sigma: vec![sigma.max(1e-5); count],
            nodes,
            normals,
        }
    }

    #[test]
    fn without_noise_values_and_gradients_are_met() {
        for kernel in [Kernel::Cubic, Kernel::Quintic, Kernel::Septic] {
            let data = contacts(25, 0.0);
            let (nodes, normals) = (data.nodes.clone(), data.normals.clone());
            let field = LocalProblem::new(kernel, data).solve(1.0).unwrap();
            for (x, n) in nodes.iter().zip(&normals) {
                let (f, g) = field.value_and_gradient(x);
                assert!(f.abs() < 1e-6 && (g - n).norm() < 1e-4, "{kernel:?} {f}");
                assert!((field.value(x) - f).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn gradient_is_the_derivative_of_the_value() {
        let problem = LocalProblem::new(Kernel::Septic, contacts(25, 0.01));
        let field = problem.solve(0.1).unwrap();
        let x = Vec3::new(0.2, -0.1, 0.15);
        let (_, g) = field.value_and_gradient(&x);
        for i in 0..3 {
            let h = Vec3::ith(i, 1e-5);
            let slope = (field.value(&(x + h)) - field.value(&(x - h))) / 2e-5;
            assert!((slope - g[i]).abs() < 1e-7);
        }
    }

    #[test]
    fn the_variance_at_the_centre_tells_how_far_a_contact_put_there_draws_the_field() {
        let sigma: f64 = 0.01;
        for kernel in [Kernel::Cubic, Kernel::Septic] {
            let base = LocalProblem::new(kernel, contacts(30, 0.02))
                .solve(0.5)
                .unwrap();
            let before = base.value(&Vec3::zeros());
            let mut data = contacts(30, 0.02);
            data.nodes.push(Vec3::zeros());
            data.normals.push(Vec3::z());
            data.position_sigma.push(sigma);
            data.normal_sigma.push(1e6);
            let after = LocalProblem::new(kernel, data).solve(0.5).unwrap();
            let share = sigma * sigma / (base.centre_variance + sigma * sigma);
            let off = after.value(&Vec3::zeros()) - before * share;
            assert!(off.abs() < 2e-3 * before.abs(), "{kernel:?} {share}");
            assert!(share < 0.95, "the test says nothing");
        }
    }

    #[test]
    fn leaving_out_shows_the_one_false_contact() {
        let mut data = contacts(30, 0.005);
        data.nodes[7].z += 0.08;
        let problem = LocalProblem::new(Kernel::Cubic, data);
        let out = problem.leave_one_out(0.1).unwrap();
        let worst = (0..30).max_by(|&a, &b| out[a][0].abs().total_cmp(&out[b][0].abs()));
        assert_eq!(worst, Some(7));
    }
}

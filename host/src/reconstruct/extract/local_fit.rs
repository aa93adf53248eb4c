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

use faer::{Mat, Par, Side, linalg::solvers::Llt, linalg::triangular_inverse};

use super::{kernel::Kernel, orthogonal::Orthogonal};
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
    /// `Q^T K Q` of the weighted kernel matrix.
    projected: Mat<f64>,
    /// `Q^T y` of the weighted data.
    data: Vec<f64>,
}

/// What leaving each datum out says about it.
pub(super) struct LeaveOneOut {
    /// Deviation of each contact from what the others say, in standard deviations: value, then gradient.
    pub deviation: Vec<[f64; 4]>,
    /// Posterior variance of the field's value at each contact, local units.
    pub variance: Vec<f64>,
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
        let mut projected = covariance(kernel, &contacts.nodes, &weight);
        polynomials.conjugate(projected.as_mut());
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

    fn factor(&self, tau2: f64) -> Option<Llt<f64>> {
        let rank = self.polynomials.rank();
        let m = self.projected.nrows() - rank;
        let inner = self.projected.submatrix(rank, rank, m, m);
        let system = Mat::from_fn(m, m, |i, j| {
            tau2 * inner[(i, j)] + if i == j { 1.0 } else { 0.0 }
        });
        Llt::new(system.as_ref(), Side::Lower).ok()
    }

    /// Solves `L u = b` for the reduced data.
    fn forward(&self, factor: &Llt<f64>) -> Mat<f64> {
        let rest = &self.data[self.polynomials.rank()..];
        let mut u = Mat::from_fn(rest.len(), 1, |i, _| rest[i]);
        faer::linalg::triangular_solve::solve_lower_triangular_in_place(
            factor.L(),
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
        let l = factor.L();
        let logarithm: f64 = (0..l.nrows()).map(|i| l[(i, i)].ln()).sum();
        Some(0.5 * quadratic + logarithm).filter(|e| e.is_finite())
    }

    /// The posterior mean for the smoothness `tau2`.
    pub(super) fn solve(&self, tau2: f64) -> Option<LocalField> {
        let factor = self.factor(tau2)?;
        let mut z = self.forward(&factor);
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            factor.L().transpose(),
            z.as_mut(),
            Par::Seq,
        );
        let rank = self.polynomials.rank();
        let top: Vec<f64> = (0..rank)
            .map(|i| {
                let known: f64 = (0..z.nrows())
                    .map(|j| self.projected[(i, rank + j)] * z[(j, 0)])
                    .sum();
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
            nodes: self.contacts.nodes.clone(),
            coefficients,
            polynomial,
        })
    }

    /// Deviations from the rest and posterior variances, from the diagonal of the projected inverse
    /// (Rasmussen and Williams 2006, section 5.4.2).
    pub(super) fn leave_one_out(&self, tau2: f64) -> Option<LeaveOneOut> {
        let factor = self.factor(tau2)?;
        let mut z = self.forward(&factor);
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            factor.L().transpose(),
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
        triangular_inverse::invert_lower_triangular(inverse.as_mut(), factor.L(), Par::Seq);
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
        let variance = (0..count)
            .map(|i| {
                let sigma = self.contacts.position_sigma[i];
                sigma * sigma * (1.0 - precision[4 * i]).max(0.0)
            })
            .collect();
        Some(LeaveOneOut {
            deviation,
            variance,
        })
    }
}

/// The weighted kernel matrix of values and gradients at the nodes, in full.
fn covariance(kernel: Kernel, nodes: &[Vec3], weight: &[f64]) -> Mat<f64> {
    let n = 4 * nodes.len();
    let mut k = Mat::<f64>::zeros(n, n);
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
            for a in 0..4 {
                for b in 0..4 {
                    let value = block[a][b] * wi[a] * wj[b];
                    k[(4 * i + a, 4 * j + b)] = value;
                    k[(4 * j + b, 4 * i + a)] = value;
                }
            }
        }
    }
    k
}

/// A solved local field in local coordinates.
#[derive(Clone, Debug)]
pub(super) struct LocalField {
    kernel: Kernel,
    nodes: Vec<Vec3>,
    /// Coefficients of the kernel and of its three derivatives, per node.
    coefficients: Vec<[f64; 4]>,
    polynomial: Vec<f64>,
}

impl LocalField {
    /// Value at `x` (local coordinates and units).
    pub(super) fn value(&self, x: &Vec3) -> f64 {
        let (terms, _) = self.kernel.monomials(x);
        let mut f: f64 = self.polynomial.iter().zip(&terms).map(|(c, t)| c * t).sum();
        for (node, c) in self.nodes.iter().zip(&self.coefficients) {
            let d = x - node;
            let r = self.kernel.radial(d.norm_squared());
            f += r.value * c[0] - r.a * (c[1] * d.x + c[2] * d.y + c[3] * d.z);
        }
        f
    }

    /// Value and gradient at `x` (local coordinates; the gradient needs no scaling).
    pub(super) fn value_and_gradient(&self, x: &Vec3) -> (f64, Vec3) {
        let (terms, slopes) = self.kernel.monomials(x);
        let mut f = 0.0;
        let mut g = Vec3::zeros();
        for (t, c) in self.polynomial.iter().enumerate() {
            f += c * terms[t];
            g += *c * Vec3::from(slopes[t]);
        }
        for (node, c) in self.nodes.iter().zip(&self.coefficients) {
            let d = x - node;
            let r = self.kernel.radial(d.norm_squared());
            let beta = Vec3::new(c[1], c[2], c[3]);
            let along = beta.dot(&d);
            f += r.value * c[0] - r.a * along;
            g += (r.a * c[0] - r.b * along) * d - r.a * beta;
        }
        (f, g)
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.nodes.len() * (size_of::<Vec3>() + size_of::<[f64; 4]>()) + self.polynomial.len() * 8
    }
}

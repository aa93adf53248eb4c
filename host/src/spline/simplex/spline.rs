//! A triangular B-spline: control points over a knot net.
//!
//! S(u) = sum over triangles I and exponents beta of c_beta^I N(u|V_beta^I). Each triangle has its own control
//! points; neighbours that share the values at their common blossom arguments save unknowns, but nothing here
//! asks for it. Sums run over triangles in rising order, so values are the same on any number of threads.

use rayon::prelude::*;

use super::knot_net::{KnotNet, Workspace};
use super::orientation::Approach;
use super::polynomial::{Blend, PlanarPolynomial};
use super::program::Jet;
use super::{SimplexError, Vec2};

/// A spline with values of type `T` over the plane; zero where no triangle's knots reach.
#[derive(Clone, Debug)]
pub struct TriangularBSpline<T> {
    net: KnotNet,
    control_points: Vec<T>,
}

impl<T: Blend> TriangularBSpline<T> {
    /// From a net and one control point per basis function: those of triangle 0 in the order of
    /// [`super::exponents`], then those of triangle 1, …
    ///
    /// # Errors
    /// [`SimplexError::ControlCount`] if their number is another.
    pub fn new(net: KnotNet, control_points: Vec<T>) -> Result<Self, SimplexError> {
        if control_points.len() != net.functions() {
            return Err(SimplexError::ControlCount {
                found: control_points.len(),
                expected: net.functions(),
            });
        }
        Ok(Self {
            net,
            control_points,
        })
    }

    /// The spline that equals a polynomial of the net's degree: its control points are the polynomial's blossom at
    /// the knots.
    ///
    /// # Errors
    /// [`SimplexError::Degree`] if the polynomial's degree is not the net's; raise or lower it first.
    pub fn of_polynomial(
        net: KnotNet,
        polynomial: &PlanarPolynomial<T>,
    ) -> Result<Self, SimplexError> {
        let control_points: Option<Vec<T>> = (0..net.triangles().len())
            .flat_map(|triangle| net.blossom_arguments(triangle))
            .map(|arguments| polynomial.blossom(&arguments))
            .collect();
        match control_points {
            Some(control_points) => Self::new(net, control_points),
            None => Err(SimplexError::Degree(polynomial.degree())),
        }
    }

    /// The knot net.
    pub fn net(&self) -> &KnotNet {
        &self.net
    }

    /// The control points, triangle by triangle.
    pub fn control_points(&self) -> &[T] {
        &self.control_points
    }

    /// The control points, to be moved.
    pub fn control_points_mut(&mut self) -> &mut [T] {
        &mut self.control_points
    }

    /// Value at `u`; `None` where no triangle's knots reach.
    pub fn value(&self, u: Vec2, workspace: &mut Workspace) -> Option<T> {
        let mut sum = None;
        for triangle in self.net.triangles_at(u) {
            let weights = self.net.values(triangle, u, Approach::default(), workspace);
            sum = self.blend(sum, triangle, weights);
        }
        sum
    }

    /// Values at many points, in parallel.
    pub fn values(&self, points: &[Vec2]) -> Vec<Option<T>>
    where
        T: Send + Sync,
    {
        points
            .par_iter()
            .map_init(Workspace::default, |workspace, u| self.value(*u, workspace))
            .collect()
    }

    /// Value and derivatives to second order at `u`, on knot lines those of the half-open rule; `None` where no
    /// triangle's knots reach.
    pub fn jet(&self, u: Vec2, workspace: &mut Workspace) -> Option<Jet<T>> {
        let per = self.net.functions_per_triangle();
        let mut sum: Option<Jet<T>> = None;
        for triangle in self.net.triangles_at(u) {
            let jets = self.net.jets(triangle, u, Approach::default(), workspace);
            for (jet, control) in jets.iter().zip(&self.control_points[triangle * per..]) {
                let term = Jet {
                    value: *control * jet.value,
                    gradient: jet.gradient.map(|part| *control * part),
                    hessian: jet.hessian.map(|part| *control * part),
                };
                sum = Some(match sum {
                    None => term,
                    Some(sum) => Jet {
                        value: sum.value + term.value,
                        gradient: [0, 1].map(|i| sum.gradient[i] + term.gradient[i]),
                        hessian: [0, 1, 2].map(|i| sum.hessian[i] + term.hessian[i]),
                    },
                });
            }
        }
        sum
    }

    /// Jets at many points, in parallel; the same bits for any number of threads.
    pub fn jets(&self, points: &[Vec2]) -> Vec<Option<Jet<T>>>
    where
        T: Send + Sync,
    {
        points
            .par_iter()
            .map_init(Workspace::default, |workspace, u| self.jet(*u, workspace))
            .collect()
    }

    /// Derivative of any order along `direction`, on knot lines exact from the side of `approach`.
    pub fn directional(
        &self,
        u: Vec2,
        approach: Approach,
        direction: Vec2,
        order: usize,
        workspace: &mut Workspace,
    ) -> Option<T> {
        let mut sum = None;
        for triangle in self.net.triangles_at(u) {
            let weights = self
                .net
                .directional(triangle, u, approach, direction, order, workspace);
            sum = self.blend(sum, triangle, weights);
        }
        sum
    }

    /// Adds a triangle's control points times their weights.
    fn blend(&self, sum: Option<T>, triangle: usize, weights: &[f64]) -> Option<T> {
        let per = self.net.functions_per_triangle();
        weights
            .iter()
            .zip(&self.control_points[triangle * per..])
            .fold(sum, |sum, (weight, control)| {
                let term = *control * *weight;
                Some(sum.map_or(term, |sum| sum + term))
            })
    }
}

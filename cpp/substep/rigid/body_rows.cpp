#include "substep/rigid/body_rows.h"

#include "substep/core/parallel.h"
#include "substep/core/point_lanes.h"

namespace substep::rigid {
namespace {

constexpr std::int64_t kGrain = 256;  // bodies per task

Point<double> to_row(const Vec3& v, double w = 0) { return {v.x(), v.y(), v.z(), w}; }
Vec3 from_row(const Point<double>& p) { return {p.x, p.y, p.z}; }

// R D R^T.
Mat3 conjugated(const Mat3& R, const Vec3& D) { return R * D.asDiagonal() * R.transpose(); }

}  // namespace

void BodyRows::load(const Bodies& bodies, const Vec3& gravity, int threads) {
  const auto n = static_cast<std::size_t>(bodies.size());
  for (Rows* rows :
       {&v, &w, &free_v, &free_w, &push_v, &push_w, &a, &alpha, &x, &r, &root, &root_mixed})
    rows->reset(n);
  first_w.reset(3 * n);
  parallel_for(
      bodies.size(), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          const auto k = static_cast<std::size_t>(i);
          const bool dynamic = bodies.dynamic(i);
          const double inverse_root = 1 / std::sqrt(bodies.mass[k]);
          const Mat3 W = conjugated(bodies.rotation(i).toRotationMatrix(),
                                    Vec3(&bodies.inertia[3 * k]).cwiseSqrt().cwiseInverse());
          root[k] = to_row(W.diagonal(), inverse_root);
          root_mixed[k] = {W(0, 1), W(0, 2), W(1, 2), dynamic ? 1. : 0.};
          const Vec3 spin = W * Vec3(&bodies.L[3 * k]);
          v[k] = to_row(Vec3(&bodies.P[3 * k]) * inverse_root);
          w[k] = to_row(spin);
          Vec3::Map(&first_w[3 * k]) = spin;
          const Vec3 force = bodies.mass[k] * gravity + Vec3(&bodies.force[3 * k]);
          a[k] = to_row(dynamic ? Vec3(force * inverse_root) : Vec3::Zero());
          alpha[k] = to_row(dynamic ? Vec3(W * Vec3(&bodies.torque[3 * k])) : Vec3::Zero());
          push_v[k] = push_w[k] = x[k] = r[k] = {};
        }
      },
      threads);
}

void BodyRows::accelerate(std::int64_t begin, std::int64_t end, double h) {
  for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
    const auto free_velocity = load_quad(v[i]) + h * load_quad(a[i]);
    const auto free_spin = load_quad(w[i]) + h * load_quad(alpha[i]);
    store_quad(free_v[i], free_velocity);
    store_quad(free_w[i], free_spin);
    store_quad(v[i], free_velocity + load_quad(push_v[i]));
    store_quad(w[i], free_spin + load_quad(push_w[i]));
  }
}

void BodyRows::move(std::int64_t begin, std::int64_t end, double h) {
  // A push below a millionth of what its acceleration gives is none.
  const auto none = [h](const auto& push, const auto& acceleration) {
    const auto p = push * push, g = acceleration * acceleration;
    return p[0] + p[1] + p[2] <= 1e-12 * h * h * (g[0] + g[1] + g[2]);
  };
  for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
    const auto velocity = load_quad(v[i]), spin = load_quad(w[i]);
    const auto push = velocity - load_quad(free_v[i]), turn = spin - load_quad(free_w[i]);
    const auto linear = load_quad(a[i]), angular = load_quad(alpha[i]);
    const double parabola = none(push, linear) && none(turn, angular) ? 0.5 * h * h : 0;
    store_quad(push_v[i], push);
    store_quad(push_w[i], turn);
    store_quad(x[i], load_quad(x[i]) + (h * velocity - parabola * linear));
    store_quad(r[i], load_quad(r[i]) + (h * spin - parabola * angular));
  }
}

void BodyRows::store(Bodies& bodies, double dt, FreeRotation method, int threads) const {
  parallel_for(
      bodies.size(), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        rotate_freely(method, end - begin, &bodies.q[4 * static_cast<std::size_t>(begin)],
                      &bodies.L[3 * static_cast<std::size_t>(begin)],
                      &bodies.inertia[3 * static_cast<std::size_t>(begin)], dt, 1);
        for (std::int64_t i = begin; i < end; ++i) {
          const auto k = static_cast<std::size_t>(i);
          Vec3::Map(&bodies.x[3 * k]) += from_row(x[k]) * root[k].w;
          if (!bodies.dynamic(i)) continue;
          Mat3 W;  // W^(1/2)
          W << root[k].x, root_mixed[k].x, root_mixed[k].y, root_mixed[k].x, root[k].y,
              root_mixed[k].z, root_mixed[k].y, root_mixed[k].z, root[k].z;
          const Vec3 first(&first_w[3 * k]);
          const Vec3 turn = from_row(r[k]) - dt * first, push = from_row(w[k]) - first;
          Vec3::Map(&bodies.P[3 * k]) = from_row(v[k]) / root[k].w;
          if (!turn.isZero(0)) {
            store_quaternion((rotation_by(W * turn) * bodies.rotation(i)).normalized(),
                             &bodies.q[4 * k]);
          }
          if (!push.isZero(0)) Vec3::Map(&bodies.L[3 * k]) += W.inverse() * push;
        }
      },
      threads);
}

}  // namespace substep::rigid

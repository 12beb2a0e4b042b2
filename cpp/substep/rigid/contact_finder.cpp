#include "substep/rigid/contact_finder.h"

#include <algorithm>

#include "substep/core/parallel.h"
#include "substep/rigid/mesh_contacts.h"
#include "substep/rigid/narrow_phase.h"
#include "substep/rigid/time_of_impact.h"

namespace substep::rigid {
namespace {

constexpr std::int64_t kPairs = 64;  // per chunk
// Slow is what approaches by less than this part of the smaller inner radius in a step.
constexpr double kSlow = 0.5, kSlowBouncing = 0.1;
constexpr double kMeeting = 1e-3;  // how near fast bodies are followed to each other, of the margin

bool apart(const Bounds& p, const Bounds& q) {
  return (p.low.array() > q.high.array()).any() || (q.low.array() > p.high.array()).any();
}

bool precedes(const ContactConstraint& c, const FixturePair& pair) {
  return c.fixture_a != pair.a ? c.fixture_a < pair.a : c.fixture_b < pair.b;
}

const TriangleMesh* mesh_of(const Shape& shape) {
  const auto* mesh = std::get_if<std::shared_ptr<const TriangleMesh>>(&shape);
  return mesh ? mesh->get() : nullptr;
}

// The contacts of one chunk of pairs.
class Search {
 public:
  Search(const Fixtures& fixtures, std::span<const Way> ways, std::vector<Cache>& caches,
         std::span<const ContactConstraint> last, bool continuous,
         std::vector<ContactConstraint>& found)
      : fixtures_(fixtures),
        ways_(ways),
        caches_(caches),
        last_(last),
        continuous_(continuous),
        found_(found) {
    found.clear();
  }

  void look_at(const FixturePair& pair) {
    if (apart(fixtures_.bounds()[at(pair.a)], fixtures_.bounds()[at(pair.b)])) return;
    const Fixtures::Entry &a = fixtures_[pair.a], &b = fixtures_[pair.b];
    const Way &way_a = ways_[at(a.body)], &way_b = ways_[at(b.body)];
    const double approach =
        (way_a.travel - way_b.travel).norm() + way_a.angle * a.outer + way_b.angle * b.outer;
    const bool bounces = a.fixture.restitution > 0 || b.fixture.restitution > 0;
    const double slow = (bounces ? kSlowBouncing : kSlow) * std::min(a.core.radius, b.core.radius);
    const double margin = std::min(a.margin, b.margin);
    const std::size_t first = found_.size();
    collide_pair(pair, fixtures_.pose(pair.a), fixtures_.pose(pair.b),
                 margin + std::min(approach, slow));
    for (const Manifold& manifold : manifolds_)
      append(pair, manifold, fixtures_.body_pose(a.body), fixtures_.body_pose(b.body));
    if (continuous_ && approach > slow && manifolds_.empty()) follow(pair, margin);
    carry(pair, first);
  }

 private:
  static std::size_t at(std::int32_t i) { return static_cast<std::size_t>(i); }

  void collide_pair(const FixturePair& pair, const Pose& pose_a, const Pose& pose_b,
                    double margin) {
    const Shape &a = fixtures_[pair.a].fixture.shape, &b = fixtures_[pair.b].fixture.shape;
    manifolds_.clear();
    if (const TriangleMesh* mesh = mesh_of(b)) {
      collide_mesh(a, pose_a, *mesh, pose_b, margin, manifolds_);
    } else if (const TriangleMesh* ground = mesh_of(a)) {
      collide_mesh(b, pose_b, *ground, pose_a, margin, manifolds_);
      for (Manifold& manifold : manifolds_) manifold.flip();
    } else {
      manifolds_.emplace_back();
      if (!collide(a, pose_a, b, pose_b, margin, manifolds_.back(), caches_[at(pair.slot)]))
        manifolds_.pop_back();
    }
  }

  // The bodies are at these poses when they meet.
  void append(const FixturePair& pair, const Manifold& manifold, const Pose& pose_a,
              const Pose& pose_b) {
    const Fixtures::Entry &a = fixtures_[pair.a], &b = fixtures_[pair.b];
    found_.push_back(make_contact(manifold, a.body, pose_a, b.body, pose_b));
    ContactConstraint& contact = found_.back();
    contact.fixture_a = pair.a, contact.fixture_b = pair.b;
    const Fixture &f = a.fixture, &g = b.fixture;
    contact.friction = std::sqrt(f.friction * g.friction);
    contact.restitution = std::max(f.restitution, g.restitution);
    contact.spinning = std::max(f.spinning, g.spinning);
    contact.rolling = std::max(f.rolling, g.rolling);
  }

  // The contact of two that will meet in this step, if they do. With displacements x and rotation
  // vectors w until then, C at the begin is
  //   C then - n . (x_b + w_b x r_b - x_a - w_a x r_a).
  void follow(const FixturePair& pair, double margin) {
    const Course a = course(pair.a), b = course(pair.b);
    const Impact impact = time_of_impact(fixtures_[pair.a].fixture.shape, a,
                                         fixtures_[pair.b].fixture.shape, b, 0, kMeeting * margin);
    if (impact.state != Impact::State::kTouching) return;
    const double t = impact.time;
    collide_pair(pair, a.at(t), b.at(t), margin);
    const auto body_at = [t](Course of) {
      of.local = {};
      return of.at(t);
    };
    const std::size_t first = found_.size();
    for (const Manifold& manifold : manifolds_) append(pair, manifold, body_at(a), body_at(b));
    for (std::size_t c = first; c < found_.size(); ++c) {
      for (int k = 0; k < found_[c].count; ++k) {
        ContactConstraint::Point& p = found_[c].points[k];
        p.separation -= t * found_[c].normal.dot((b.travel + b.turn.cross(p.arm_b)) -
                                                 (a.travel + a.turn.cross(p.arm_a)));
      }
    }
  }

  Course course(std::int32_t f) const {
    const std::int32_t body = fixtures_[f].body;
    const Way& way = ways_[at(body)];
    return {fixtures_.body_pose(body), way.travel, way.turn, fixtures_[f].fixture.local};
  }

  // Of several contacts of one pair (on a mesh) each takes the impulses of the one with the nearest
  // normal.
  void carry(const FixturePair& pair, std::size_t first) {
    const auto begin = std::lower_bound(last_.begin(), last_.end(), pair, precedes);
    const auto end = std::find_if(begin, last_.end(), [&](const ContactConstraint& c) {
      return c.fixture_a != pair.a || c.fixture_b != pair.b;
    });
    last_ = last_.subspan(static_cast<std::size_t>(begin - last_.begin()));
    for (std::size_t k = first; begin != end && k < found_.size(); ++k) {
      const auto nearest = std::max_element(begin, end, [&](const auto& c, const auto& d) {
        return c.normal.dot(found_[k].normal) < d.normal.dot(found_[k].normal);
      });
      carry_impulses(*nearest, found_[k]);
    }
  }

  const Fixtures& fixtures_;
  std::span<const Way> ways_;
  std::vector<Cache>& caches_;
  std::span<const ContactConstraint> last_;  // from this pair on
  bool continuous_;
  std::vector<ContactConstraint>& found_;
  std::vector<Manifold> manifolds_;
};

}  // namespace

void ContactFinder::find(std::span<const FixturePair> pairs, std::int32_t slots,
                         const Fixtures& fixtures, std::span<const Way> ways,
                         std::span<const ContactConstraint> last, bool continuous,
                         std::vector<ContactConstraint>& contacts, int threads) {
  caches_.resize(static_cast<std::size_t>(slots));
  const auto n = static_cast<std::int64_t>(pairs.size());
  found_.resize(static_cast<std::size_t>((n + kPairs - 1) / kPairs));
  parallel_for(
      n, kPairs,
      [&](std::int64_t begin, std::int64_t end) {
        Search search(fixtures, ways, caches_, last, continuous,
                      found_[static_cast<std::size_t>(begin / kPairs)]);
        for (std::int64_t k = begin; k < end; ++k)
          search.look_at(pairs[static_cast<std::size_t>(k)]);
      },
      threads);
  std::size_t count = 0;
  for (const auto& found : found_) count += found.size();
  contacts.clear();
  contacts.reserve(count);
  for (const auto& found : found_) contacts.insert(contacts.end(), found.begin(), found.end());
}

}  // namespace substep::rigid

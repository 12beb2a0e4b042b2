#include "substep/rigid/world/contact_finder.h"

#include <algorithm>
#include <array>
#include <limits>
#include <new>
#include <optional>
#include <utility>

#include "substep/core/parallel.h"
#include "substep/core/prefetch.h"
#include "substep/core/usize.h"
#include "substep/rigid/collision/mesh_contacts.h"
#include "substep/rigid/collision/narrow_phase.h"
#include "substep/rigid/distance/time_of_impact.h"

namespace substep::rigid {
namespace {

constexpr std::int64_t kPairs = 64;  // per chunk
// Slow is what approaches by less than this part of the smaller inner radius in a step.
constexpr double kSlow = 0.5, kSlowBouncing = 0.1;
// Tilts of what pivots on an edge or a corner, and turns in a step [rad].
constexpr double kTilted = 1e-3, kPivots = 3e-3;
constexpr double kStill = 1e-3;    // what goes no farther in a step is at rest, of Seams::kFlush
constexpr double kMeeting = 1e-3;  // how near fast bodies are followed to each other, of the margin

// Whether no face of the bodies lies on the other.
bool on_edge(const ContactConstraint& contact) {
  const auto* const end = contact.points + contact.count;
  const auto& nearest = *std::min_element(contact.points, end, [](const auto& p, const auto& q) {
    return p.separation < q.separation;
  });
  return std::count_if(contact.points, end, [&](const auto& p) {
           const double away = (p.position - nearest.position).norm();
           return p.separation - nearest.separation <= kTilted * away;
         }) <= 2;
}

// Whether the bounds are above the plane, if it is one.
bool above(const Shape& shape, const Pose& pose, const Bounds& bounds) {
  const auto* plane = std::get_if<Plane>(&shape);
  if (!plane) return false;
  const Vec3 n = pose.rotation * plane->normal;
  const double lowest = n.cwiseProduct(bounds.low).cwiseMin(n.cwiseProduct(bounds.high)).sum();
  return lowest > plane->offset + n.dot(pose.position);
}

const TriangleMesh* mesh_of(const Shape& shape) {
  const auto* mesh = std::get_if<std::shared_ptr<const TriangleMesh>>(&shape);
  return mesh ? mesh->get() : nullptr;
}

Pose body_at(Course course, double time) {
  course.local = {};
  return course.at(time);
}

// Between two that move midway; else on the surface of the one that does, which so rolls by its
// radius however deep it is.
double acts_at(std::span<const Motion> motion, std::int32_t a, std::int32_t b) {
  if (motion[usize(a)] != Motion::kDynamic) return 1;
  return motion[usize(b)] != Motion::kDynamic ? 0 : 0.5;
}

// Of the strip that the points lie in: an area over its length.
double width(const Manifold& manifold) {
  const ContactPoint* const p = manifold.points;
  if (manifold.count <= 2) return 0;
  const Vec3 across = p[2].on_a - p[0].on_a,
             other = p[manifold.count - 1].on_a - p[manifold.count == 3 ? 0 : 1].on_a;
  const double length = std::sqrt(std::max(across.squaredNorm(), other.squaredNorm()));
  return 0.5 * across.cross(other).norm() / length;
}

bool may_catch(const Shape& shape) {
  return !std::holds_alternative<Sphere>(shape) && !std::holds_alternative<Plane>(shape);
}

bool is_round(const Shape& shape) {
  return std::holds_alternative<Sphere>(shape) || std::holds_alternative<Capsule>(shape) ||
         std::holds_alternative<Cylinder>(shape);
}

}  // namespace

// Of a chunk of pairs.
class ContactFinder::Search {
 public:
  Search(const Fixtures& fixtures, std::span<const Motion> motion, std::span<const Way> ways,
         bool continuous, std::vector<Cache>& caches, std::vector<Touch>& found)
      : fixtures_(fixtures),
        motion_(motion),
        ways_(ways),
        continuous_(continuous),
        caches_(caches),
        found_(found) {}

  // The pair with this number: whether it touches, or else is near.
  void look_at(const FixturePair& pair, std::int64_t number, Setbacks::Found& setbacks,
               std::vector<Seams::Edge>& edges) {
    // Pairs that the broad phase still has from where they were find no more than new ones do.
    const Fixtures::Entry &a = fixtures_[pair.a], &b = fixtures_[pair.b];
    const Bounds &box_a = fixtures_.bounds()[usize(pair.a)],
                 &box_b = fixtures_.bounds()[usize(pair.b)];
    if (apart(box_a, box_b) || above(a.fixture.shape, fixtures_.pose(pair.a), box_b) ||
        above(b.fixture.shape, fixtures_.pose(pair.b), box_a))
      return;
    const double slow = slow_for(a, b), margin = std::min(a.margin, b.margin);
    const double travel = (ways_[usize(a.body)].travel - ways_[usize(b.body)].travel).norm();
    const double approach = travel + turns_by(a, b), range = margin + std::min(approach, slow);
    const bool free = is_free(a.body) && is_free(b.body);
    const std::size_t before = found_.size();
    const auto add = [&](const Touch& touch) {
      const Setbacks::Push push = push_of(touch);
      if (free) setbacks.pushes.push_back(push);
      stop(touch, push, margin, setbacks);
      if (meets_on_edge(touch, push))
        edges.push_back({pair.a, pair.b, push.normal, static_cast<std::int32_t>(found_.size())});
      found_.push_back(touch);
    };
    collide_at(pair, fixtures_.pose(pair.a), fixtures_.pose(pair.b), range, 0, add);
    if (found_.size() > before) return;
    if (continuous_ && approach > slow) follow(pair, margin, add);
    if (found_.size() == before && free)
      setbacks.near.push_back({.a = a.body,
                               .b = b.body,
                               .pair = static_cast<std::int32_t>(number),
                               .least = range - travel});
  }

  // A pair of which one is set back.
  std::optional<Setbacks::Push> look_behind(const FixturePair& pair,
                                            const Setbacks::Approach& approach) {
    const Fixtures::Entry &a = fixtures_[pair.a], &b = fixtures_[pair.b];
    const double range =
        std::min(a.margin, b.margin) + std::min({approach.length, a.core.radius, b.core.radius});
    std::optional<Setbacks::Push> met;
    collide_at(pair, fixtures_.pose(pair.a), fixtures_.pose(pair.b), range, 0,
               [&](const Touch& touch) {
                 const Setbacks::Push push = push_of(touch);
                 if (!(approach.closing.dot(push.normal) > push.gap)) return;
                 met = push;
                 found_.push_back(touch);
               });
    return met;
  }

  ContactConstraint contact(const Touch& touch) const {
    const Fixtures::Entry &a = fixtures_[touch.pair.a], &b = fixtures_[touch.pair.b];
    ContactConstraint contact =
        touch.time > 0
            ? later(touch)
            : make_contact(touch.manifold, a.body, fixtures_.body_pose(a.body), b.body,
                           fixtures_.body_pose(b.body), acts_at(motion_, a.body, b.body));
    contact.rolls_on = is_round(a.fixture.shape) || is_round(b.fixture.shape);
    const double turn = std::max(ways_[usize(a.body)].angle, ways_[usize(b.body)].angle);
    contact.tips = touch.time == 0 &&
                   (turns_by(a, b) > slow_for(a, b) || (turn > kPivots && on_edge(contact)));
    contact.fixture_a = touch.pair.a, contact.fixture_b = touch.pair.b;
    const Surface surface = fixtures_.surface(a.fixture, b.fixture);
    contact.friction = surface.friction;
    contact.static_friction = surface.static_friction;
    contact.restitution = surface.restitution;
    contact.spinning = surface.spinning;
    contact.rolling = surface.rolling;
    return contact;
  }

 private:
  bool is_free(std::int32_t body) const { return motion_[usize(body)] == Motion::kDynamic; }

  Setbacks::Push push_of(const Touch& touch) const {
    const Fixtures::Entry &a = fixtures_[touch.pair.a], &b = fixtures_[touch.pair.b];
    const auto* const points = touch.manifold.points;
    double gap = std::numeric_limits<double>::infinity();
    for (int k = 0; k < touch.manifold.count; ++k) gap = std::min(gap, points[k].separation);
    return {a.body, b.body, touch.manifold.normal, std::max(gap, 0.0),
            1 + fixtures_.restitution(a.fixture, b.fixture)};
  }

  // Whether the two stop each other on their ways, or throw each other back, by more than what is
  // nearer than the margin and so touches anyway.
  void stop(const Touch& touch, const Setbacks::Push& push, double margin,
            Setbacks::Found& setbacks) const {
    const double way = push.normal.dot(ways_[usize(push.a)].travel - ways_[usize(push.b)].travel);
    if (!(way > 0)) return;
    const double left = touch.time > 0 ? (1 - touch.time) * way : way - push.gap;
    const double back = push.bounce * left;
    if (!(back > margin)) return;
    if (is_free(push.a)) setbacks.stops.push_back({push.a, -back * push.normal});
    if (is_free(push.b)) setbacks.stops.push_back({push.b, back * push.normal});
  }

  // Whether a seam may be all that the two meet at. At its own time, one that lies on another is
  // where it would have fallen.
  bool meets_on_edge(const Touch& touch, const Setbacks::Push& push) const {
    const Fixtures::Entry &a = fixtures_[touch.pair.a], &b = fixtures_[touch.pair.b];
    if (!may_catch(a.fixture.shape) || !may_catch(b.fixture.shape)) return false;
    const double flush = Seams::kFlush * std::min(a.margin, b.margin);
    const double way = push.normal.dot(ways_[usize(push.a)].travel - ways_[usize(push.b)].travel);
    const double still = kStill * flush;
    return touch.time > 0 ||
           (way > std::max(push.gap - still, still) && width(touch.manifold) <= 2 * flush);
  }

  // How far points of them go in the step as they turn.
  double turns_by(const Fixtures::Entry& a, const Fixtures::Entry& b) const {
    return ways_[usize(a.body)].angle * a.outer + ways_[usize(b.body)].angle * b.outer;
  }
  double slow_for(const Fixtures::Entry& a, const Fixtures::Entry& b) const {
    const bool bounces = fixtures_.restitution(a.fixture, b.fixture) > 0;
    return (bounces ? kSlowBouncing : kSlow) * std::min(a.core.radius, b.core.radius);
  }

  // found(touch) for each.
  template <class Found>
  void collide_at(const FixturePair& pair, const Pose& pose_a, const Pose& pose_b, double margin,
                  double time, const Found& found) {
    const Shape &a = fixtures_[pair.a].fixture.shape, &b = fixtures_[pair.b].fixture.shape;
    const TriangleMesh *mesh_a = mesh_of(a), *mesh_b = mesh_of(b);
    touch_.pair = pair, touch_.time = time;
    if (!mesh_a && !mesh_b) {
      Cache& cache = caches_[usize(pair.slot)];
      if (collide(a, pose_a, b, pose_b, margin, touch_.manifold, cache)) found(touch_);
      return;
    }
    manifolds_.clear();
    if (mesh_b) {
      collide_mesh(a, pose_a, *mesh_b, pose_b, margin, manifolds_);
    } else {
      collide_mesh(b, pose_b, *mesh_a, pose_a, margin, manifolds_);
      for (Manifold& manifold : manifolds_) manifold.flip();
    }
    for (const Manifold& manifold : manifolds_) {
      touch_.manifold = manifold;
      found(touch_);
    }
  }

  // Where two will meet in this step, if they do.
  template <class Found>
  void follow(const FixturePair& pair, double margin, const Found& found) {
    const Course a = course(pair.a), b = course(pair.b);
    const Impact impact = time_of_impact(fixtures_[pair.a].fixture.shape, a,
                                         fixtures_[pair.b].fixture.shape, b, 0, kMeeting * margin);
    if (impact.state == Impact::State::kTouching)
      collide_at(pair, a.at(impact.time), b.at(impact.time), margin, impact.time, found);
  }

  // With displacements x and rotation vectors w until then, C at the start is
  //   C then - n . (x_b + w_b x r_b - x_a - w_a x r_a).
  ContactConstraint later(const Touch& touch) const {
    const Course a = course(touch.pair.a), b = course(touch.pair.b);
    ContactConstraint contact =
        make_contact(touch.manifold, fixtures_[touch.pair.a].body, body_at(a, touch.time),
                     fixtures_[touch.pair.b].body, body_at(b, touch.time));
    for (int k = 0; k < contact.count; ++k) {
      ContactConstraint::Point& p = contact.points[k];
      p.separation -= touch.time * contact.normal.dot((b.travel + b.turn.cross(p.arm_b)) -
                                                      (a.travel + a.turn.cross(p.arm_a)));
    }
    return contact;
  }

  Course course(std::int32_t f) const {
    const std::int32_t body = fixtures_[f].body;
    const Way& way = ways_[usize(body)];
    return {fixtures_.body_pose(body), way.travel, way.turn, fixtures_[f].fixture.local};
  }

  const Fixtures& fixtures_;
  std::span<const Motion> motion_;
  std::span<const Way> ways_;
  bool continuous_;
  std::vector<Cache>& caches_;
  std::vector<Touch>& found_;
  Touch touch_{};
  std::vector<Manifold> manifolds_;
};

namespace {

// Goes through the contacts of the last step along with those of this one.
class Carry {
 public:
  Carry(std::span<const ContactConstraint> last, const ContactConstraint& first)
      : next_(std::lower_bound(last.begin(), last.end(), first, precedes)), end_(last.end()) {}

  // Of several contacts of one pair (on a mesh) each takes the impulses of the one with the nearest
  // normal.
  void operator()(ContactConstraint& contact) {
    if (end_ - next_ > 2) prefetch(next_[2]);  // most likely that of the contact that is next
    while (next_ != end_ && precedes(*next_, contact)) ++next_;
    auto nearest = next_;
    for (auto c = next_; c != end_ && !precedes(contact, *c); ++c)
      if (c->normal.dot(contact.normal) > nearest->normal.dot(contact.normal)) nearest = c;
    if (nearest != end_ && !precedes(contact, *nearest)) carry_impulses(*nearest, contact);
  }

 private:
  std::span<const ContactConstraint>::iterator next_, end_;
};

}  // namespace

bool ContactFinder::touch_at(const Fixtures& fixtures, std::span<const Motion> motion,
                             const Pose& body_a, const Pose& body_b, ContactConstraint& contact) {
  const Fixture &a = fixtures[contact.fixture_a].fixture, &b = fixtures[contact.fixture_b].fixture;
  const Pose pose_a = body_a * a.local, pose_b = body_b * b.local;
  const TriangleMesh *mesh_a = mesh_of(a.shape), *mesh_b = mesh_of(b.shape);
  Manifold one;
  std::vector<Manifold> of_mesh;
  std::span<Manifold> manifolds(&one, 1);
  if (mesh_a) {
    collide_mesh(b.shape, pose_b, *mesh_a, pose_a, contact.margin, of_mesh);
    for (Manifold& manifold : of_mesh) manifold.flip();
  } else if (mesh_b) {
    collide_mesh(a.shape, pose_a, *mesh_b, pose_b, contact.margin, of_mesh);
  } else {
    Cache cache;
    collide(a.shape, pose_a, b.shape, pose_b, contact.margin, one, cache);
  }
  if (mesh_a || mesh_b) manifolds = of_mesh;
  const auto nearest = std::max_element(manifolds.begin(), manifolds.end(), [&](auto& p, auto& q) {
    return p.normal.dot(contact.normal) < q.normal.dot(contact.normal);
  });
  if (nearest == manifolds.end() || nearest->count == 0) return false;
  const ContactConstraint now = make_contact(*nearest, contact.a, body_a, contact.b, body_b,
                                             acts_at(motion, contact.a, contact.b));
  contact.normal = now.normal, contact.tangent = now.tangent, contact.count = now.count;
  std::copy(now.points, now.points + 4, contact.points);
  return true;
}

void ContactFinder::leave_out_seams(const Fixtures& fixtures, std::span<const Way> ways) {
  if (std::all_of(edges_.begin(), edges_.end(), [](const auto& of) { return of.empty(); })) return;
  const auto bodies = static_cast<std::int64_t>(ways.size());
  seams_.begin(edges_, fixtures, bodies, [&](const auto& has_edge, const auto& visit) {
    for (const auto& found : touches_) {
      for (const Touch& touch : found) {
        const auto [a, b] = std::pair(touch.pair.a, touch.pair.b);
        if (!has_edge(a) && !has_edge(b)) continue;
        const Vec3& n = touch.manifold.normal;
        const ContactPoint& p = touch.manifold.points[0];
        const double flush = Seams::kFlush * std::min(fixtures[a].margin, fixtures[b].margin);
        if (touch.time == 0 && p.separation <= flush)
          visit({a, b, n, 0.5 * n.dot(p.on_a + p.on_b)});
      }
    }
  });
  for (std::size_t c = 0; c < edges_.size(); ++c) {
    for (const Seams::Edge& edge : edges_[c])
      if (seams_.parted(edge, fixtures, ways)) touches_[c][usize(edge.touch)].manifold.count = 0;
    std::erase_if(touches_[c], [](const Touch& t) { return t.manifold.count == 0; });
  }
}

void ContactFinder::find_followers(std::span<const FixturePair> pairs, const Fixtures& fixtures,
                                   std::span<const Motion> motion, std::span<const Way> ways) {
  const auto chunk_of = [](std::int32_t pair) { return usize(pair / kPairs); };
  followers_.clear();
  const auto meet = [&](std::int32_t pair, const Setbacks::Approach& approach) {
    Search search(fixtures, motion, ways, false, caches_, touches_[chunk_of(pair)]);
    const auto push = search.look_behind(pairs[usize(pair)], approach);
    if (push) followers_.push_back(pair);
    return push;
  };
  setbacks_.spread(found_, pairs, fixtures, ways, meet);
  for (const std::int32_t pair : followers_) {
    auto& touches = touches_[chunk_of(pair)];
    std::stable_sort(touches.begin(), touches.end(), [](const Touch& p, const Touch& q) {
      return std::pair(p.pair.a, p.pair.b) < std::pair(q.pair.a, q.pair.b);
    });
  }
}

std::optional<RoundPair> ContactFinder::round_pair(const Fixtures& fixtures,
                                                   std::span<const Motion> motion,
                                                   const ContactConstraint& contact) {
  const auto get = [&](std::int32_t f, RoundShape& round) {
    const Shape& shape = fixtures[f].fixture.shape;
    const Pose& pose = fixtures.pose(f);
    if (const auto* sphere = std::get_if<Sphere>(&shape)) {
      round = {pose.position, Vec3::Zero(), sphere->radius, false};
    } else if (const auto* capsule = std::get_if<Capsule>(&shape)) {
      round = {pose.position, capsule->half_length * pose.rotation.col(2), capsule->radius, false};
    } else if (const auto* plane = std::get_if<Plane>(&shape)) {
      const Vec3 n = pose.rotation * plane->normal;
      round = {pose.position + plane->offset * n, n, 0, true};
    } else {
      return false;
    }
    return true;
  };
  RoundPair pair;
  if (!get(contact.fixture_a, pair.a) || !get(contact.fixture_b, pair.b)) return std::nullopt;
  pair.acts = acts_at(motion, contact.a, contact.b);
  return pair;
}

void ContactFinder::find(std::span<const FixturePair> pairs, std::int32_t slots,
                         const Fixtures& fixtures, std::span<const Motion> motion,
                         std::span<const Way> ways, std::span<const ContactConstraint> last,
                         bool continuous, std::vector<ContactConstraint>& contacts, int threads) {
  caches_.resize(usize(slots));
  const auto n = static_cast<std::int64_t>(pairs.size());
  const auto chunks = usize((n + kPairs - 1) / kPairs);
  touches_.resize(chunks), found_.resize(chunks), edges_.resize(chunks);
  parallel_for(
      n, kPairs,
      [&](std::int64_t begin, std::int64_t end) {
        auto& touches = touches_[usize(begin / kPairs)];
        auto& found = found_[usize(begin / kPairs)];
        auto& edges = edges_[usize(begin / kPairs)];
        touches.clear(), found.clear(), edges.clear();
        Search search(fixtures, motion, ways, continuous, caches_, touches);
        for (std::int64_t k = begin; k < end; ++k) search.look_at(pairs[usize(k)], k, found, edges);
      },
      threads);
  leave_out_seams(fixtures, ways);
  find_followers(pairs, fixtures, motion, ways);
  first_.assign(1, 0);
  for (const auto& found : touches_) first_.push_back(first_.back() + found.size());
  contacts.resize(first_.back());
  parallel_chunks(
      static_cast<std::int64_t>(chunks),
      [&](std::int64_t chunk) {
        const auto c = usize(chunk);
        if (touches_[c].empty()) return;
        const Search search(fixtures, motion, ways, continuous, caches_, touches_[c]);
        ContactConstraint* contact = &contacts[first_[c]];
        contact->fixture_a = touches_[c][0].pair.a, contact->fixture_b = touches_[c][0].pair.b;
        Carry carry(last, *contact);
        for (const Touch& touch : touches_[c]) {
          new (contact) ContactConstraint(search.contact(touch));  // which is large, in place
          carry(*contact++);
        }
      },
      threads);
}

}  // namespace substep::rigid

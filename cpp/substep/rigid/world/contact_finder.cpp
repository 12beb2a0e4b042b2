#include "substep/rigid/world/contact_finder.h"

#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <utility>

#include "substep/core/parallel.h"
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

bool is_round(const Shape& shape) {
  return std::holds_alternative<Sphere>(shape) || std::holds_alternative<Capsule>(shape) ||
         std::holds_alternative<Cylinder>(shape);
}

}  // namespace

// Of bodies, by how much they are behind their ways at the end of the step [m].
class ContactFinder::Setbacks {
 public:
  // Between two bodies that both move freely.
  struct Link {
    std::int32_t a, b;
    std::int64_t pair;     // -1: they touch
    double margin;         // of the pair
    double looked = 0;     // backs of both, squared, when it was looked at
    std::size_t push = 0;  // if they touch
  };

  Setbacks(const Fixtures& fixtures, std::span<const Motion> motion, std::span<const Way> ways)
      : fixtures_(fixtures), motion_(motion), ways_(ways) {}

  bool any() const { return !queue_.empty(); }

  // The two stop each other on their ways, or throw each other back.
  void stop(const Touch& touch) {
    const Fixtures::Entry &a = fixtures_[touch.pair.a], &b = fixtures_[touch.pair.b];
    const Vec3& n = touch.manifold.normal;
    const double way = n.dot(ways_[usize(a.body)].travel - ways_[usize(b.body)].travel);
    if (!(way > 0)) return;
    const double left = touch.time > 0 ? (1 - touch.time) * way : way - gap(touch);
    const double back = bounce(touch.pair) * left;
    if (!(back > std::min(a.margin, b.margin))) return;  // what is nearer touches anyway
    set(a.body, -back * n), set(b.body, back * n);
  }

  void add(const FixturePair& pair, std::int64_t number) {
    const Fixtures::Entry &a = fixtures_[pair.a], &b = fixtures_[pair.b];
    if (is_free(a.body) && is_free(b.body))
      links_.push_back({a.body, b.body, number, std::min(a.margin, b.margin)});
  }
  void add(const Touch& touch) {
    const std::size_t before = links_.size();
    add(touch.pair, -1);
    if (links_.size() > before) join(links_.back(), touch);
  }
  void join(Link& link, const Touch& touch) {
    link.pair = -1, link.push = pushes_.size();
    pushes_.push_back({touch.manifold.normal, gap(touch), bounce(touch.pair)});
  }

  // pass(link) for those of the bodies that are set back, one after the other, until none is by
  // more than it was.
  template <class Pass>
  void spread(const Pass& pass) {
    boxes_.resize(usize(fixtures_.size()));
    for (std::int32_t f = 0; f < fixtures_.size(); ++f)
      if (is_free(fixtures_[f].body))
        boxes_[usize(f)] = bounds(fixtures_[f].fixture.shape, fixtures_.pose(f));
    std::vector<std::size_t> first(bodies_.size() + 1, 0), of_body(2 * links_.size());
    for (const Link& link : links_) ++first[usize(link.a)], ++first[usize(link.b)];
    for (std::size_t b = 1; b < first.size(); ++b) first[b] += first[b - 1];
    for (std::size_t i = links_.size(); i-- > 0;)
      of_body[--first[usize(links_[i].a)]] = of_body[--first[usize(links_[i].b)]] = i;
    for (std::size_t k = 0; k < queue_.size(); ++k) {
      const auto body = usize(queue_[k]);
      bodies_[body].waits = false;
      for (std::size_t i = first[body]; i < first[body + 1]; ++i) pass(links_[of_body[i]]);
    }
  }

  // One that is set back stops the other, or throws it back.
  void pass_on(const Link& link) {
    const Push& push = pushes_[link.push];
    const auto passed = [&](const Vec3& back) {
      const double by = back.dot(push.normal);
      return std::min(push.bounce * (by - push.gap), by);
    };
    const double of_a = passed(bodies_[usize(link.a)].back),
                 of_b = passed(-bodies_[usize(link.b)].back);
    if (of_a > 0) set(link.b, of_a * push.normal);
    if (of_b > 0) set(link.a, -of_b * push.normal);
  }

  bool is_news(Link& link) const {
    const double now =
        bodies_[usize(link.a)].back.squaredNorm() + bodies_[usize(link.b)].back.squaredNorm();
    return std::exchange(link.looked, now) != now;
  }

  // How much the two approach in all, and whether they may and do.
  double approach(const Link& link) const {
    const auto a = usize(link.a), b = usize(link.b);
    return (bodies_[a].back - bodies_[b].back).norm() + (ways_[a].travel - ways_[b].travel).norm();
  }
  bool may_close(const Link& link, const FixturePair& pair) const {
    const auto a = usize(link.a), b = usize(link.b);
    const Vec3 way = ways_[b].travel - ways_[a].travel;
    const Vec3 end = way + bodies_[b].back - bodies_[a].back;
    Bounds box = boxes_[usize(pair.b)];
    box.low += end.cwiseMin(way).cwiseMin(-link.margin);
    box.high += end.cwiseMax(way).cwiseMax(link.margin);
    return !apart(boxes_[usize(pair.a)], box);
  }
  bool closes(const Touch& touch) const {
    const auto a = usize(fixtures_[touch.pair.a].body), b = usize(fixtures_[touch.pair.b].body);
    const Vec3 way = ways_[a].travel - ways_[b].travel + bodies_[a].back - bodies_[b].back;
    return way.dot(touch.manifold.normal) > gap(touch);
  }

 private:
  // Rounding must not make one larger and larger that goes round a body between two others.
  static constexpr double kMore = 1.01;
  struct Push {
    Vec3 normal;
    double gap, bounce;
  };
  struct Body {
    Vec3 back = Vec3::Zero();
    bool waits = false;  // in the queue
  };

  bool is_free(std::int32_t body) const { return motion_[usize(body)] == Motion::kDynamic; }
  double bounce(const FixturePair& pair) const {
    return 1 + fixtures_.restitution(fixtures_[pair.a].fixture, fixtures_[pair.b].fixture);
  }
  static double gap(const Touch& touch) {
    double least = std::numeric_limits<double>::infinity();
    for (int k = 0; k < touch.manifold.count; ++k)
      least = std::min(least, touch.manifold.points[k].separation);
    return std::max(least, 0.0);
  }

  void set(std::int32_t body, const Vec3& back) {
    if (!is_free(body)) return;
    bodies_.resize(motion_.size());
    Body& of = bodies_[usize(body)];
    if (!(back.squaredNorm() > kMore * of.back.squaredNorm())) return;
    of.back = back;
    if (!of.waits) queue_.push_back(body);
    of.waits = true;
  }

  const Fixtures& fixtures_;
  std::span<const Motion> motion_;
  std::span<const Way> ways_;
  std::vector<Body> bodies_;
  std::vector<Link> links_;
  std::vector<Push> pushes_;
  std::vector<Bounds> boxes_;  // of fixtures, where they are
  std::vector<std::int32_t> queue_;
};

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

  // Whether they touch, or else may be near.
  std::optional<bool> look_at(const FixturePair& pair) {
    // Pairs that the broad phase still has from where they were find no more than new ones do.
    const Fixtures::Entry &a = fixtures_[pair.a], &b = fixtures_[pair.b];
    const Bounds &box_a = fixtures_.bounds()[usize(pair.a)],
                 &box_b = fixtures_.bounds()[usize(pair.b)];
    if (apart(box_a, box_b) || above(a.fixture.shape, fixtures_.pose(pair.a), box_b) ||
        above(b.fixture.shape, fixtures_.pose(pair.b), box_a))
      return {};
    const double slow = slow_for(a, b), margin = std::min(a.margin, b.margin);
    const double approach =
        (ways_[usize(a.body)].travel - ways_[usize(b.body)].travel).norm() + turns_by(a, b);
    const std::size_t before = found_.size();
    collide_at(pair, fixtures_.pose(pair.a), fixtures_.pose(pair.b),
               margin + std::min(approach, slow), 0);
    if (continuous_ && approach > slow && found_.size() == before) follow(pair, margin);
    return found_.size() > before;
  }

  // A pair of which one is set back.
  void look_behind(const FixturePair& pair, const Setbacks::Link& link, const Setbacks& setbacks) {
    if (!setbacks.may_close(link, pair)) return;
    const Fixtures::Entry &a = fixtures_[pair.a], &b = fixtures_[pair.b];
    const std::size_t before = found_.size();
    collide_at(pair, fixtures_.pose(pair.a), fixtures_.pose(pair.b),
               link.margin + std::min({setbacks.approach(link), a.core.radius, b.core.radius}), 0);
    if (found_.size() > before && !setbacks.closes(found_.back())) found_.pop_back();
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
  // How far points of them go in the step as they turn.
  double turns_by(const Fixtures::Entry& a, const Fixtures::Entry& b) const {
    return ways_[usize(a.body)].angle * a.outer + ways_[usize(b.body)].angle * b.outer;
  }
  double slow_for(const Fixtures::Entry& a, const Fixtures::Entry& b) const {
    const bool bounces = fixtures_.restitution(a.fixture, b.fixture) > 0;
    return (bounces ? kSlowBouncing : kSlow) * std::min(a.core.radius, b.core.radius);
  }

  void collide_at(const FixturePair& pair, const Pose& pose_a, const Pose& pose_b, double margin,
                  double time) {
    const Shape &a = fixtures_[pair.a].fixture.shape, &b = fixtures_[pair.b].fixture.shape;
    const TriangleMesh *mesh_a = mesh_of(a), *mesh_b = mesh_of(b);
    if (!mesh_a && !mesh_b) {
      found_.push_back({pair, time, {}});
      if (!collide(a, pose_a, b, pose_b, margin, found_.back().manifold, caches_[usize(pair.slot)]))
        found_.pop_back();
      return;
    }
    manifolds_.clear();
    if (mesh_b) {
      collide_mesh(a, pose_a, *mesh_b, pose_b, margin, manifolds_);
    } else {
      collide_mesh(b, pose_b, *mesh_a, pose_a, margin, manifolds_);
      for (Manifold& manifold : manifolds_) manifold.flip();
    }
    for (const Manifold& manifold : manifolds_) found_.push_back({pair, time, manifold});
  }

  // Where two will meet in this step, if they do.
  void follow(const FixturePair& pair, double margin) {
    const Course a = course(pair.a), b = course(pair.b);
    const Impact impact = time_of_impact(fixtures_[pair.a].fixture.shape, a,
                                         fixtures_[pair.b].fixture.shape, b, 0, kMeeting * margin);
    if (impact.state == Impact::State::kTouching)
      collide_at(pair, a.at(impact.time), b.at(impact.time), margin, impact.time);
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

void ContactFinder::find_followers(std::span<const FixturePair> pairs, const Fixtures& fixtures,
                                   std::span<const Motion> motion, std::span<const Way> ways) {
  Setbacks setbacks(fixtures, motion, ways);
  for (const auto& found : touches_)
    for (const Touch& touch : found) setbacks.stop(touch);
  if (!setbacks.any()) return;
  for (const auto& found : touches_)
    for (const Touch& touch : found) setbacks.add(touch);
  for (const auto& near : near_)
    for (const std::int64_t k : near) setbacks.add(pairs[usize(k)], k);
  setbacks.spread([&](Setbacks::Link& link) {
    if (link.pair >= 0 && setbacks.is_news(link)) {
      auto& found = touches_[usize(link.pair / kPairs)];
      const std::size_t before = found.size();
      Search(fixtures, motion, ways, false, caches_, found)
          .look_behind(pairs[usize(link.pair)], link, setbacks);
      if (found.size() > before) setbacks.join(link, found.back());
    }
    if (link.pair < 0) setbacks.pass_on(link);
  });
  for (auto& found : touches_)
    std::stable_sort(found.begin(), found.end(), [](const Touch& p, const Touch& q) {
      return std::pair(p.pair.a, p.pair.b) < std::pair(q.pair.a, q.pair.b);
    });
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
  touches_.resize(chunks), near_.resize(chunks);
  parallel_for(
      n, kPairs,
      [&](std::int64_t begin, std::int64_t end) {
        auto& found = touches_[usize(begin / kPairs)];
        auto& near = near_[usize(begin / kPairs)];
        found.clear(), near.clear();
        Search search(fixtures, motion, ways, continuous, caches_, found);
        for (std::int64_t k = begin; k < end; ++k)
          if (!search.look_at(pairs[usize(k)]).value_or(true)) near.push_back(k);
      },
      threads);
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
          *contact = search.contact(touch);
          carry(*contact++);
        }
      },
      threads);
}

}  // namespace substep::rigid

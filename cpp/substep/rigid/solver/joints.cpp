#include "substep/rigid/solver/joints.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <utility>

#include "substep/core/usize.h"
#include "substep/rigid/solver/islands.h"

namespace substep::rigid {

void JointSolver::begin_step(const Bodies& bodies, std::span<const Joint> joints,
                             std::span<const ContactConstraint> contacts,
                             const JointGroup::Settings& settings, BodyRows& rows) {
  found_.clear();
  for (std::size_t k = 0; k < joints.size(); ++k) {
    const Joint& joint = joints[k];
    const bool moves_a = rows.moves(rows.row(joint.a)), moves_b = rows.moves(rows.row(joint.b));
    if ((!moves_a && !moves_b) || joint_rows(joint) == 0) continue;
    found_.push_back({static_cast<std::int32_t>(k), joint.a, joint.b, joint.type, joint_rows(joint),
                      moves_a, moves_b, rows.row(joint.a) == 0, rows.row(joint.b) == 0});
  }
  if (found_ != keys_) find_groups(bodies, joints, rows);
  if (groups_.empty()) return;

  pressed_.assign(usize(bodies.size()), 0);
  for (const ContactConstraint& c : contacts) {
    if (c.count == 0) continue;
    const bool presses = std::any_of(c.points, c.points + c.count, [](const auto& point) {
      return point.impulse > 0 || point.separation <= 0;
    });
    for (const std::int32_t body : {c.a, c.b}) {
      std::uint8_t& how = pressed_[usize(body)];
      how = std::max(how, std::uint8_t{presses ? JointGroup::kPressed : JointGroup::kNear});
    }
  }
  for (Group& group : groups_) group.begin_step(joints, pressed_, bodies, settings, rows);
}

// In the order of their first joints.
void JointSolver::find_groups(const Bodies& bodies, std::span<const Joint> joints,
                              const BodyRows& rows) {
  keys_.clear();
  groups_.clear();
  std::vector<BodyPair> pairs;
  for (const Key& key : found_)
    pairs.push_back({key.moves_a ? key.a : -1, key.moves_b ? key.b : -1});
  label_.resize(usize(bodies.size()));
  label_islands(pairs, label_);
  std::map<std::int32_t, std::size_t> group_of;
  std::vector<std::vector<std::int32_t>> numbers;
  for (const Key& key : found_) {
    const std::int32_t label = label_[usize(key.moves_a ? key.a : key.b)];
    const auto group = group_of.emplace(label, numbers.size()).first->second;
    if (group == numbers.size()) numbers.emplace_back();
    numbers[group].push_back(key.number);
  }
  for (auto& list : numbers) groups_.emplace_back(std::move(list), joints, rows);
  keys_ = found_;
}

void JointSolver::mark_whirling(std::span<std::uint8_t> bodies) const {
  for (const Group& group : groups_)
    if (group.whirls()) group.mark_bodies(bodies);
}

void JointSolver::store(Bodies& bodies, std::span<Joint> joints, double dt) const {
  for (const Group& group : groups_) group.store(bodies, joints, dt);
  for (Joint& joint : joints) {
    if (joint_rows(joint) > 0) continue;
    joint.coordinate = joint_coordinate(joint, bodies);  // all that it has
    joint.force = joint.torque = Vec3::Zero();
    joint.effort = joint.length_error = joint.angle_error = 0;
    joint.impulse.fill(0);
  }
}

}  // namespace substep::rigid

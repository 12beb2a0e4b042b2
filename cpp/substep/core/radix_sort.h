// Stable counting sort of (key, index) pairs, digit by digit from the lowest one: parallel, and the
// same result for any number of threads. Few entries are sorted by comparing them: the order is the
// same, and counters need not be cleared.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep {

template <class Key>
struct KeyedIndex {
  Key key;
  std::int32_t index;
};

template <class Key>
class RadixSort {
 public:
  // Sorts by the lowest `bits` bits; the higher ones must be equal.
  void operator()(std::vector<KeyedIndex<Key>>& entries, int bits, int threads) {
    if (entries.size() < kFew) {
      std::stable_sort(entries.begin(), entries.end(),
                       [](const auto& x, const auto& y) { return x.key < y.key; });
      return;
    }
    const int passes = (bits + kMaxDigit - 1) / kMaxDigit;
    for (int pass = 0, shift = 0; pass < passes; ++pass) {
      const int digit = (bits - shift + passes - pass - 1) / (passes - pass);
      sort_digit(entries, shift, digit, threads);
      shift += digit;
    }
  }

  std::size_t bytes() const {
    return other_.capacity() * sizeof(other_[0]) + places_.capacity() * sizeof(places_[0]);
  }

 private:
  static constexpr std::size_t kFew = 1024;  // entries
  static constexpr int kMaxDigit = 11;       // bits: the counters of a chunk stay in the L1 cache
  static constexpr std::int64_t kGrain = 32768;  // entries per chunk

  void sort_digit(std::vector<KeyedIndex<Key>>& entries, int shift, int digit, int threads) {
    const auto n = static_cast<std::int64_t>(entries.size());
    const std::int64_t digits = std::int64_t{1} << digit;
    const auto value = [=](const KeyedIndex<Key>& entry) {
      return (entry.key >> shift) & static_cast<Key>(digits - 1);
    };
    places_.assign(usize(((n + kGrain - 1) / kGrain) * digits), 0);
    parallel_for(
        n, kGrain,
        [&](std::int64_t begin, std::int64_t end) {
          std::int32_t* const count = places_.data() + begin / kGrain * digits;
          for (std::int64_t i = begin; i < end; ++i) {
            ++count[value(entries[usize(i)])];
          }
        },
        threads);
    if (!counts_to_places(n, digits)) return;
    other_.resize(entries.size());
    parallel_for(
        n, kGrain,
        [&](std::int64_t begin, std::int64_t end) {
          std::int32_t* const place = places_.data() + begin / kGrain * digits;
          for (std::int64_t i = begin; i < end; ++i) {
            const KeyedIndex<Key> entry = entries[usize(i)];
            other_[usize(place[value(entry)]++)] = entry;
          }
        },
        threads);
    entries.swap(other_);
  }

  // Where the first entry of each digit of each chunk goes. False if there is one digit only.
  bool counts_to_places(std::int64_t n, std::int64_t digits) {
    std::vector<std::int32_t> next(usize(digits), 0);
    for (std::size_t k = 0; k < places_.size(); ++k) {
      next[k % usize(digits)] += places_[k];
    }
    std::int32_t before = 0;
    for (std::int32_t& count : next) {
      if (count == n) return false;
      before += std::exchange(count, before);
    }
    for (std::size_t k = 0; k < places_.size(); ++k) {
      std::int32_t& place = next[k % usize(digits)];
      place += std::exchange(places_[k], place);
    }
    return true;
  }

  std::vector<KeyedIndex<Key>> other_;
  std::vector<std::int32_t> places_;  // of each chunk and digit
};

}  // namespace substep

// The linear system of the speed planner's interior-point method.
#ifndef IITS_MJ_KERNELS_NODE_SYSTEM_H_
#define IITS_MJ_KERNELS_NODE_SYSTEM_H_

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "kernels/vectors.h"

namespace iits {

// (H + G' C' W C G) x = r with H tridiagonal, G the durations' gradients, C their running sum and W
// the weights of the times at nodes 1..n. If only the last time has a weight, the system is H with
// a border. Else (`inner`) the times and the prices of the intervals are further unknowns: b[k],
// t[k], price[k] at 3 k, 3 k + 1, 3 k + 2, in three bands on either side.
class NodeSystem {
 public:
  NodeSystem(std::size_t n, bool inner)
      : diagonal(n + 1),
        beside(n),
        d0(n),
        d1(n),
        weights(n),
        n_(n),
        inner_(inner),
        factor_(n + 1),
        below_(n),
        border_(n + 1),
        answer_(n + 1) {
    if (inner) {
      rows_.resize(kWide * Size());
      order_.resize(Size());
      full_.resize(Size());
    }
  }

  // Of H: diagonal (n + 1) and beside it (n); derivatives of the durations; weights.
  Vector diagonal, beside, d0, d1, weights;

  // Returns whether H is positive definite and every pivot differs from 0.
  bool Factor() {
    factor_ = diagonal;
    for (std::size_t k = 0; k < n_; ++k) {
      if (factor_[k] <= 0.0) return false;
      below_[k] = beside[k] / factor_[k];
      factor_[k + 1] -= below_[k] * beside[k];
    }
    if (factor_[n_] <= 0.0) return false;
    if (inner_) return FactorBands();
    if (weights[n_ - 1] > 0.0) {
      std::fill(border_.begin(), border_.end(), 0.0);
      for (std::size_t k = 0; k < n_; ++k) {
        border_[k] += d0[k];
        border_[k + 1] += d1[k];
      }
      answer_ = border_;
      SolveTridiagonal(&answer_);
      pivot_ = 1.0 / weights[n_ - 1] + Dot(border_, answer_);
    }
    return true;
  }

  // Replaces a right side (n + 1) by the solution.
  void Solve(Vector* x) {
    if (inner_) {
      SolveBands(x);
      return;
    }
    SolveTridiagonal(x);
    if (weights[n_ - 1] > 0.0) Add(*x, -Dot(border_, *x) / pivot_, answer_, x);
  }

 private:
  static constexpr std::size_t kBands = 3, kWide = 10;  // with the rows exchanged for pivots

  std::size_t Size() const { return 3 * n_ + 2; }  // the last price does not exist
  double& At(std::size_t row, std::size_t column) {
    return rows_[kWide * row + column + kBands - row];
  }

  void SolveTridiagonal(Vector* right) const {
    Vector& x = *right;
    for (std::size_t k = 0; k < n_; ++k) x[k + 1] -= below_[k] * x[k];
    x[n_] /= factor_[n_];
    for (std::size_t k = n_; k-- > 0;) x[k] = x[k] / factor_[k] - below_[k] * x[k + 1];
  }

  void FillBands() {
    std::fill(rows_.begin(), rows_.end(), 0.0);
    At(1, 1) = 1.0;  // a unit weight keeps t[0] at 0
    for (std::size_t k = 0; k <= n_; ++k) At(3 * k, 3 * k) = diagonal[k];
    for (std::size_t k = 0; k < n_; ++k) {
      const std::size_t b = 3 * k, t = b + 1, price = b + 2, next_b = b + 3, next_t = b + 4;
      At(b, next_b) = At(next_b, b) = beside[k];
      At(b, price) = At(price, b) = d0[k];
      At(next_b, price) = At(price, next_b) = d1[k];
      // W t[k+1] + price[k+1] - price[k] = 0, and grad d . b + t[k] - t[k+1] = 0 without t[0].
      At(next_t, next_t) = weights[k];
      At(next_t, price) = At(price, next_t) = -1.0;
      if (k > 0) At(t, price) = At(price, t) = 1.0;
    }
  }

  // Elimination with exchange of rows; keeps the factors in the place of the zeros.
  bool FactorBands() {
    FillBands();
    for (std::size_t j = 0; j < Size(); ++j) {
      const std::size_t bottom = std::min(j + kBands, Size() - 1);
      const std::size_t right = std::min(j + 2 * kBands, Size() - 1);
      std::size_t best = j;
      for (std::size_t i = j + 1; i <= bottom; ++i) {
        if (std::fabs(At(i, j)) > std::fabs(At(best, j))) best = i;
      }
      order_[j] = best;
      if (At(best, j) == 0.0) return false;
      if (best != j) {
        for (std::size_t c = j; c <= right; ++c) std::swap(At(j, c), At(best, c));
      }
      for (std::size_t i = j + 1; i <= bottom; ++i) {
        const double factor = At(i, j) /= At(j, j);
        if (factor == 0.0) continue;
        for (std::size_t c = j + 1; c <= right; ++c) At(i, c) -= factor * At(j, c);
      }
    }
    return true;
  }

  void SolveBands(Vector* right_side) {
    Vector& x = full_;
    std::fill(x.begin(), x.end(), 0.0);
    for (std::size_t k = 0; k <= n_; ++k) x[3 * k] = (*right_side)[k];
    for (std::size_t j = 0; j < Size(); ++j) {
      std::swap(x[j], x[order_[j]]);
      const std::size_t bottom = std::min(j + kBands, Size() - 1);
      for (std::size_t i = j + 1; i <= bottom; ++i) x[i] -= At(i, j) * x[j];
    }
    for (std::size_t j = Size(); j-- > 0;) {
      const std::size_t right = std::min(j + 2 * kBands, Size() - 1);
      for (std::size_t c = j + 1; c <= right; ++c) x[j] -= At(j, c) * x[c];
      x[j] /= At(j, j);
    }
    for (std::size_t k = 0; k <= n_; ++k) (*right_side)[k] = x[3 * k];
  }

  std::size_t n_;
  bool inner_;
  Vector factor_, below_, border_, answer_;
  double pivot_ = 0.0;
  Vector rows_, full_;
  std::vector<std::size_t> order_;
};

}  // namespace iits

#endif  // IITS_MJ_KERNELS_NODE_SYSTEM_H_

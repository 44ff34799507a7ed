// A part between two rigid bodies as a force element in C++17: one wb_joint_step a step.
// Include it beside wrenchbook.h, and link the library of `wrenchbook export bar bar.zip`.
#pragma once
#include "wrenchbook.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

namespace wrenchbook {

using Wrench = std::array<double, 6>;  // or velocity: linear, then angular

// The joint of a table with one interface and no further inputs, for one thread.
class Joint {
public:
    static constexpr double max_ranges = 2.0;  // further out the pose is not that of the part

    Joint(const std::string &path, double dt, double damping) {
        if (!(dt > 0) || !(damping >= 0) || !std::isfinite(dt + damping))
            throw std::invalid_argument("dt is finite and above 0, damping finite and 0 or more");
        char why[256] = "";
        table_ = wb_open(path.c_str(), why, sizeof why);
        if (!table_) throw std::runtime_error(path + ": " + why);
        if (wb_inputs(table_) != 6) {
            wb_close(table_);
            throw std::runtime_error(path + ": a part with one interface and no further inputs is needed");
        }
        options_.answer.method = WB_DEFAULT;  // 0 would be WB_GRIDDATA
        options_.dt = dt, options_.damping = damping, options_.errors = 1;
        memory_.assign(wb_joint_memory(table_), 0.0);
        scratch_.resize(wb_scratch(table_) / sizeof(double) + 1);
    }
    ~Joint() { wb_close(table_); }
    Joint(const Joint &) = delete;
    Joint &operator=(const Joint &) = delete;

    double dt() const { return options_.dt; }

    // The wrench on the part, N and N m, in the undeformed frame about the interface point where it
    // is: the tip feels its negative, the base the wrench itself at the same point. The pose is of
    // the tip's interface frame in the undeformed one, m and quaternion, w first; velocity and
    // inverse mass (6, 6) as wb_joint_step has them.
    Wrench step(const std::array<double, 7> &pose, const Wrench &velocity,
                const std::array<double, 36> &inverse_mass) {
        const int wrong = wb_joint_step(table_, &options_, 1, pose.data(), velocity.data(),
                                        inverse_mass.data(), memory_.data(), &reply_, 1, scratch_.data());
        if (wrong || reply_.status)
            throw std::runtime_error("no wrench at this pose: code " +
                                     std::to_string(wrong ? wrong : reply_.status));
        if (!(reply_.ranges <= max_ranges))
            throw std::runtime_error("the pose needs " + std::to_string(reply_.ranges) +
                                     " times the load range");
        Wrench wrench;
        std::copy_n(reply_.wrench, 6, wrench.begin());
        return wrench;
    }

    // Of the last step: error bars, coverage, how far out.
    const wb_joint_reply &reply() const { return reply_; }

private:
    wb_table *table_ = nullptr;
    wb_joint options_{};
    wb_joint_reply reply_{};
    std::vector<double> memory_, scratch_;
};

}  // namespace wrenchbook

// A part that bends between two bodies, as a node of ROS 2 for a simulator on the other side.
//
// It subscribes to `relative`, an Odometry of the tip's interface frame in the undeformed one: its
// twist, in the tip's axes as Odometry has it, is the one that the bodies would have after the step
// without the part. It publishes `wrench`, on the part in the undeformed frame: apply its negative to
// the tip, and itself to the base at the same point, in the next step of the length `dt`. Parameters:
// table, damping, dt, inverse_mass (36 numbers, row by row; see wrenchbook.h). A simulator that waits
// for the wrench of each step has the law of the joint; one that does not has it a step late.
// The project's tests compile it against stubs of ROS's headers, and do not run it in ROS.
#include <rclcpp/rclcpp.hpp>

#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <nav_msgs/msg/odometry.hpp>

#include "joint.hpp"

class JointNode : public rclcpp::Node {
public:
    JointNode()
        : Node("wrenchbook_joint"),
          joint_(declare_parameter<std::string>("table", "bar.wbt"), declare_parameter<double>("dt", 1e-3),
                 declare_parameter<double>("damping", 0.02)) {
        const auto given = declare_parameter<std::vector<double>>("inverse_mass", std::vector<double>());
        if (given.size() != inverse_mass_.size())
            throw std::invalid_argument("inverse_mass has 36 numbers: (6, 6), row by row");
        std::copy(given.begin(), given.end(), inverse_mass_.begin());
        publisher_ = create_publisher<geometry_msgs::msg::WrenchStamped>("wrench", 1);
        subscription_ = create_subscription<nav_msgs::msg::Odometry>(
            "relative", 1, [this](const nav_msgs::msg::Odometry &motion) { step(motion); });
    }

private:
    void step(const nav_msgs::msg::Odometry &motion) {
        const auto &p = motion.pose.pose.position;
        const auto &q = motion.pose.pose.orientation;
        const auto &v = motion.twist.twist.linear, &w = motion.twist.twist.angular;
        // From the tip's axes to the undeformed frame's: v + 2 u x (u x v + q.w v), u = (q.x, q.y, q.z).
        const auto turned = [&q](double x, double y, double z) {
            const double a = q.y * z - q.z * y + q.w * x, b = q.z * x - q.x * z + q.w * y,
                         c = q.x * y - q.y * x + q.w * z;
            return std::array<double, 3>{x + 2 * (q.y * c - q.z * b), y + 2 * (q.z * a - q.x * c),
                                         z + 2 * (q.x * b - q.y * a)};
        };
        const auto linear = turned(v.x, v.y, v.z), angular = turned(w.x, w.y, w.z);
        geometry_msgs::msg::WrenchStamped message;
        message.header = motion.header;
        try {
            const auto wrench = joint_.step({p.x, p.y, p.z, q.w, q.x, q.y, q.z},
                                            {linear[0], linear[1], linear[2], angular[0], angular[1],
                                             angular[2]},
                                            inverse_mass_);
            auto &force = message.wrench.force, &torque = message.wrench.torque;
            force.x = wrench[0], force.y = wrench[1], force.z = wrench[2];
            torque.x = wrench[3], torque.y = wrench[4], torque.z = wrench[5];
            publisher_->publish(message);
        } catch (const std::runtime_error &error) {  // no message: the simulator must not go on
            RCLCPP_ERROR(get_logger(), "%s", error.what());
        }
    }

    wrenchbook::Joint joint_;
    std::array<double, 36> inverse_mass_{};
    rclcpp::Publisher<geometry_msgs::msg::WrenchStamped>::SharedPtr publisher_;
    rclcpp::Subscription<nav_msgs::msg::Odometry>::SharedPtr subscription_;
};

int main(int count, char **words) {
    rclcpp::init(count, words);
    rclcpp::spin(std::make_shared<JointNode>());
    rclcpp::shutdown();
}

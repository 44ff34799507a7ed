// A part that bends between two links of a model, as a system plugin of Gazebo (gz-sim 8).
//
//   <plugin filename="gz_joint" name="wrenchbook::GzJoint">
//     <table>bar.wbt</table> <base>base</base> <tip>tip</tip>
//     <pose>1 0 0 0 0 0</pose> <damping>0.02</damping>
//   </plugin>
//
// No joint of SDF connects the two links. <pose> is the undeformed interface frame in the base's link
// frame; the tip's link frame is its interface frame. Gazebo gives plugins no mass matrix, so the
// inverse mass is that of two free links: where others hang on them the part is damped more. The
// velocity is that before the step: gravity cancels between two free links.
// The project's tests compile it against stubs of Gazebo's headers, and do not run it in Gazebo.
#include <gz/math/Pose3.hh>
#include <gz/plugin/Register.hh>
#include <gz/sim/Link.hh>
#include <gz/sim/Model.hh>
#include <gz/sim/System.hh>
#include <sdf/Element.hh>

#include <memory>

#include "joint.hpp"

namespace wrenchbook {

using gz::math::Pose3d;
using gz::math::Vector3d;

class GzJoint : public gz::sim::System,
                public gz::sim::ISystemConfigure,
                public gz::sim::ISystemPreUpdate {
public:
    void Configure(const gz::sim::Entity &entity, const std::shared_ptr<const sdf::Element> &sdf,
                   gz::sim::EntityComponentManager &ecm, gz::sim::EventManager &) override {
        const gz::sim::Model model(entity);
        base_ = gz::sim::Link(model.LinkByName(ecm, sdf->Get<std::string>("base")));
        tip_ = gz::sim::Link(model.LinkByName(ecm, sdf->Get<std::string>("tip")));
        if (!base_.Valid(ecm) || !tip_.Valid(ecm))
            throw std::runtime_error("the model has no such links as <base> and <tip>");
        undeformed_ = sdf->Get<Pose3d>("pose");
        path_ = sdf->Get<std::string>("table");
        damping_ = sdf->Get<double>("damping", 0.02).first;
        base_.EnableVelocityChecks(ecm);
        tip_.EnableVelocityChecks(ecm);
    }

    void PreUpdate(const gz::sim::UpdateInfo &info, gz::sim::EntityComponentManager &ecm) override {
        const auto base = base_.WorldPose(ecm), tip = tip_.WorldPose(ecm);
        if (info.paused || !base || !tip || !tip_.WorldLinearVelocity(ecm)) return;
        const double dt = std::chrono::duration<double>(info.dt).count();
        if (!joint_ || joint_->dt() != dt) joint_ = std::make_unique<Joint>(path_, dt, damping_);

        const Pose3d frame = *base * undeformed_;
        const Vector3d moved = frame.Rot().RotateVectorReverse(tip->Pos() - frame.Pos());
        const auto turned = frame.Rot().Inverse() * tip->Rot();
        // Against the point of the base that is now at the interface point.
        const Vector3d at = base->Rot().RotateVectorReverse(tip->Pos() - base->Pos());
        const Vector3d linear = *tip_.WorldLinearVelocity(ecm) - *base_.WorldLinearVelocity(ecm, at);
        const Vector3d angular = *tip_.WorldAngularVelocity(ecm) - *base_.WorldAngularVelocity(ecm);
        const Vector3d v = frame.Rot().RotateVectorReverse(linear);
        const Vector3d spin = frame.Rot().RotateVectorReverse(angular);

        std::array<double, 36> inverse_mass{};
        for (int load = 0; load < 6; load++) {
            Vector3d unit;
            unit[load % 3] = 1.0;
            unit = frame.Rot().RotateVector(unit);
            const Vector3d force = load < 3 ? unit : Vector3d(), moment = load < 3 ? Vector3d() : unit;
            for (const auto *link : {&base_, &tip_}) {
                const auto inertial = link->WorldInertial(ecm);
                const auto inertia = link->WorldInertiaMatrix(ecm);
                if (!inertial || !inertia) throw std::runtime_error("a link has no inertia");
                const Vector3d arm = tip->Pos() - inertial->Pose().Pos();
                const Vector3d turn = inertia->Inverse() * (moment + arm.Cross(force));
                const Vector3d push = force * (1.0 / inertial->MassMatrix().Mass()) + turn.Cross(arm);
                const Vector3d rows[] = {frame.Rot().RotateVectorReverse(push),
                                         frame.Rot().RotateVectorReverse(turn)};
                for (int row = 0; row < 6; row++) inverse_mass[6 * row + load] += rows[row / 3][row % 3];
            }
        }
        const Wrench wrench = joint_->step({moved[0], moved[1], moved[2], turned.W(), turned.X(),
                                            turned.Y(), turned.Z()},
                                           {v[0], v[1], v[2], spin[0], spin[1], spin[2]}, inverse_mass);
        const Vector3d force = frame.Rot().RotateVector({wrench[0], wrench[1], wrench[2]});
        const Vector3d moment = frame.Rot().RotateVector({wrench[3], wrench[4], wrench[5]});
        tip_.AddWorldWrench(ecm, force * -1.0, moment * -1.0);
        base_.AddWorldWrench(ecm, force, moment + (tip->Pos() - base->Pos()).Cross(force));
    }

private:
    gz::sim::Link base_, tip_;
    Pose3d undeformed_;
    std::string path_;
    double damping_ = 0.02;
    std::unique_ptr<Joint> joint_;
};

}  // namespace wrenchbook

GZ_ADD_PLUGIN(wrenchbook::GzJoint, gz::sim::System, wrenchbook::GzJoint::ISystemConfigure,
              wrenchbook::GzJoint::ISystemPreUpdate)
